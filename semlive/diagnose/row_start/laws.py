"""Law of the settling at the start of rows: in time, in position on the specimen, or in pixels of the scan generator.

A beam that settles in time settles over fewer pixels if the dwell is longer. A multi-beam microscope kept the length, in nanometres, with
four times the dwell (templiert/scan_correction). At one pixel size and one dwell, all laws are the same, and part of the distortion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import Outcome
from semlive.diagnose.row_start.profile import FittedProfile, RowStartProfile, fit_profile

Array = NDArray[np.float64]
MIN_LOG_ODDS = math.log(20.0)
MIN_SIGNIFICANCE = 4.0  # standard uncertainties of the amplitude
SCATTERS = np.geomspace(0.02, 0.3, 8)  # standard deviation of logarithms from setting to setting that no law describes
WIDEST = 10.0  # prior standard deviation of the logarithms of a law's constants
RATIOS = (0.5, 1.0, 2.0, 4.0)  # pixel sizes and dwell times of possible experiments, relative to the last setting


class RowStartLaw(StrEnum):
    """Laws of the settling. The amplitude of the first two is a displacement on the specimen, of the third one of the scan generator."""

    TIME = "row_start_settling_in_time"
    POSITION = "row_start_settling_in_position"
    PIXELS = "row_start_settling_in_pixels"


@dataclass(frozen=True, slots=True)
class Setting:
    """A pixel size, nm, and the time from pixel to pixel, s."""

    pixel_nm: float
    pixel_s: float

    @classmethod
    def of(cls, profile: RowStartProfile) -> Setting:
        """The setting of a profile."""
        return cls(profile.pixel_nm, profile.pixel_s)


@dataclass(frozen=True, slots=True)
class SettlingExperiment:
    """A further setting and its expected log odds.

    Attributes:
        setting: pixel size and time per pixel.
        log_odds: expected log odds of the true law against its closest rival, for the law for which they are smallest.
        hardest: the law for which they are smallest.
    """

    setting: Setting
    log_odds: float
    hardest: RowStartLaw


@dataclass(frozen=True, slots=True)
class RowStartVerdict:
    """Verdict on the law of the settling.

    Attributes:
        outcome: NONE without significant settling, IDENTIFIED, AMBIGUOUS, or UNKNOWN if no law describes the settings.
        laws: the laws that describe the settings equally well, the most likely first.
        terms: number of exponentials, 1 or 2.
        evidence: log evidence of each law.
        amplitudes: amplitude of each exponential by the most likely law, nm, or px for the law in pixels.
        constants: length of each exponential, nm, s or px by the law.
        scatter: relative standard deviation of amplitudes and lengths from setting to setting.
        experiments: further settings, the most decisive first; empty if the law is identified.
    """

    outcome: Outcome
    laws: tuple[RowStartLaw, ...]
    terms: int
    evidence: Mapping[RowStartLaw, float]
    amplitudes: tuple[float, ...] = ()
    constants: tuple[float, ...] = ()
    scatter: float = 0.0
    experiments: tuple[SettlingExperiment, ...] = ()


def row_start_law(profiles: Sequence[RowStartProfile]) -> RowStartVerdict:
    """Determine the law from profiles at several settings.

    The number of exponentials is the one with the smaller Bayesian information criterion over all profiles. Logarithms of amplitudes and
    lengths then follow each law up to a constant, with a common scatter that is integrated over.
    """
    fits = _fits(profiles)
    if not fits:
        return RowStartVerdict(Outcome.NONE, (), 0, {})
    evidence = {law: log_evidence(fits, law) for law in RowStartLaw}
    ranked = sorted(RowStartLaw, key=lambda law: -evidence[law])
    laws = tuple(law for law in ranked if evidence[law] > evidence[ranked[0]] - MIN_LOG_ODDS)
    constants, scatter = law_constants(fits, ranked[0])
    outcome = Outcome.IDENTIFIED if len(laws) == 1 else Outcome.AMBIGUOUS
    if len(fits) > 1 and scatter >= SCATTERS[-1]:
        outcome = Outcome.UNKNOWN
    terms = fits[0].terms
    values = np.exp(constants)
    experiments = () if outcome is Outcome.IDENTIFIED else possible_settings(fits, laws)
    amplitudes, lengths = values[:terms].tolist(), values[terms:].tolist()
    return RowStartVerdict(outcome, laws, terms, evidence, tuple(amplitudes), tuple(lengths), scatter, experiments)


def _fits(profiles: Sequence[RowStartProfile]) -> list[FittedProfile]:
    """Fits of the significant profiles with one number of exponentials."""
    single = [fit for profile in profiles if (fit := fit_profile(profile, 1)) is not None and fit.significance > MIN_SIGNIFICANCE]
    double = [fit for fit in (fit_profile(one.profile, 2) for one in single) if fit is not None]
    if len(double) < len(single) or any(fit.significance < MIN_SIGNIFICANCE for fit in double):
        return single
    gain = sum(one.chi2 - two.chi2 - 2.0 * math.log(len(one.profile.distance_px)) for one, two in zip(single, double, strict=True))
    return double if gain > 2.0 * MIN_LOG_ODDS else single


def scaled(setting: Setting, law: RowStartLaw, terms: int) -> Array:
    """(2 k,) logarithms of unit amplitudes and lengths of a law, in px, at a setting."""
    amplitude = 0.0 if law is RowStartLaw.PIXELS else -math.log(setting.pixel_nm)
    length = {
        RowStartLaw.TIME: -math.log(setting.pixel_s),
        RowStartLaw.POSITION: -math.log(setting.pixel_nm),
        RowStartLaw.PIXELS: 0.0,
    }[law]
    return np.repeat([amplitude, length], terms)


def log_evidence(fits: Sequence[FittedProfile], law: RowStartLaw) -> float:
    """Log evidence of a law, its constants and the scatter integrated over."""
    return float(np.logaddexp.reduce([_at_scatter(fits, law, scatter)[0] for scatter in SCATTERS]) - math.log(len(SCATTERS)))


def law_constants(fits: Sequence[FittedProfile], law: RowStartLaw) -> tuple[Array, float]:
    """(2 k,) logarithms of a law's constants, and the most likely scatter."""
    results = [_at_scatter(fits, law, scatter) for scatter in SCATTERS]
    best = int(np.argmax([evidence for evidence, _ in results]))
    return results[best][1], float(SCATTERS[best])


def _at_scatter(fits: Sequence[FittedProfile], law: RowStartLaw, scatter: float) -> tuple[float, Array]:
    return _gaussian(
        [fit.logarithms - scaled(Setting.of(fit.profile), law, fit.terms) for fit in fits],
        [fit.covariance + scatter**2 * np.eye(2 * fit.terms) for fit in fits],
    )


def _gaussian(data: Sequence[Array], covariances: Sequence[Array]) -> tuple[float, Array]:
    """Log evidence of a common mean with a wide prior about the mean of the data, and its posterior mean."""
    count, centre = len(data[0]), np.mean(data, axis=0)
    precision, right, fit = np.eye(count) / WIDEST**2, np.zeros(count), -count * math.log(WIDEST)
    for value, covariance in zip(data, covariances, strict=True):
        weight = np.linalg.inv(covariance)
        precision, right = precision + weight, right + weight @ (value - centre)
        fit -= 0.5 * float((value - centre) @ weight @ (value - centre)) + 0.5 * float(np.linalg.slogdet(covariance)[1])
    mean = np.linalg.solve(precision, right)
    return fit + 0.5 * float(right @ mean) - 0.5 * float(np.linalg.slogdet(precision)[1]), centre + mean


def possible_settings(fits: Sequence[FittedProfile], laws: Sequence[RowStartLaw]) -> tuple[SettlingExperiment, ...]:
    """Settings with other pixel sizes and dwell times, the most decisive first.

    For each law, the profile expected at the new setting is added to the data with the covariance of the last profile.
    """
    last = fits[-1]
    rivals = laws if len(laws) > 1 else tuple(RowStartLaw)
    experiments = []
    for by_pixel in RATIOS:
        for by_dwell in RATIOS:
            if by_pixel == by_dwell == 1.0:
                continue
            setting = Setting(last.profile.pixel_nm * by_pixel, last.profile.pixel_s * by_dwell)
            odds = {true: _expected_odds(fits, setting, true, rivals) for true in rivals}
            hardest = min(odds, key=lambda law: odds[law])
            experiments.append(SettlingExperiment(setting, odds[hardest], hardest))
    return tuple(sorted(experiments, key=lambda experiment: -experiment.log_odds))


def _expected_odds(fits: Sequence[FittedProfile], setting: Setting, true: RowStartLaw, rivals: Sequence[RowStartLaw]) -> float:
    constants, _ = law_constants(fits, true)
    last = fits[-1]
    expected = constants + scaled(setting, true, last.terms)
    profile = RowStartProfile(setting.pixel_nm, setting.pixel_s, *(np.zeros(0) for _ in range(3)))
    sizes = np.exp(expected)
    new = FittedProfile(profile, sizes[: last.terms], sizes[last.terms :], last.covariance, 0.0)
    evidence = {law: log_evidence([*fits, new], law) for law in rivals}
    return evidence[true] - max(value for law, value in evidence.items() if law is not true)
