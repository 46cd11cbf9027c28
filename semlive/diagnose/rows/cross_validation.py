"""Cross-validation in the rows: waves on segments excluded from the fit, jitter by the variance predicted by other pairs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import HeldOutMisfit
from semlive.diagnose.rows.jitter import DETRENDED, CommonRowVariance
from semlive.diagnose.rows.series import RowSeries
from semlive.diagnose.rows.spectrum import Wave, fit_wave

Array = NDArray[np.float64]
FOLDS = 4
BOOTSTRAP_DRAWS = 400
MIN_EXPLAINED_FRACTION = 0.5


def held_out_row_misfit(series: Sequence[RowSeries], waves: Sequence[Wave], jitter: CommonRowVariance | None) -> HeldOutMisfit:
    """Misfit of each pair without and with effects fitted to other pairs and other segments of its rows.

    The frequency of a wave is that of all pairs. Its amplitude and phase are fitted to every second segment and scored on the others, and
    vice versa. Effects random in every row are not predictable; for them the predicted variance is scored.

    Args:
        series: row series before correction for any effect.
        waves: the identified waves.
        jitter: common row variance after removal of the waves; None without jitter.
    """
    parts = [_of_wave(series, wave) for wave in waves] + ([] if jitter is None else [_of_jitter(jitter)])
    before_power, after_power, noise = (np.sum([part[at] for part in parts], axis=0) for at in range(3))
    rng = np.random.default_rng(43)
    samples = [rng.integers(0, len(before_power), len(before_power)) for _ in range(BOOTSTRAP_DRAWS)]
    closures = [_closure(before_power[value], after_power[value], noise[value]) for value in samples]
    low, high = (float(value) for value in np.quantile(closures, (0.025, 0.975)))
    gain = before_power - after_power
    spread = float(np.std(gain, ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else float(noise.mean())
    sizes = [float(np.sqrt(max(np.mean(value), 0.0))) for value in (before_power, after_power, noise)]
    return HeldOutMisfit(
        sizes[0], sizes[1], sizes[2], _closure(before_power, after_power, noise), (low, high), float(gain.mean()) / max(spread, 1e-12)
    )


def is_useful(gap: HeldOutMisfit) -> bool:
    """Whether the misfit reduction on held-out data is positive and not significantly below half."""
    return gap.gain_in_sigmas > 0.0 and gap.closure_interval[1] > MIN_EXPLAINED_FRACTION


def _closure(before_power: Array, after_power: Array, noise: Array) -> float:
    return float(np.sum(before_power - after_power)) / max(float(np.sum(before_power - noise)), 1e-3 * float(np.sum(noise)), 1e-18)


def _of_wave(series: Sequence[RowSeries], wave: Wave) -> tuple[Array, Array, Array]:
    """(pairs,) mean squares in the shape of the wave, px^2: before, after, and by noise alone."""
    halves = [[run_series.pieces(range(first, len(run_series.middle_px), 2)) for run_series in series] for first in (0, 1)]
    fits = [fit_wave(half, wave.frequency_hz) for half in halves]
    before_power, after_power, noise = (np.zeros(len(series)) for _ in range(3))
    for fitted, scored in (fits, fits[::-1]):
        power = np.mean(np.clip(np.abs(fitted.amplitude) ** 2 - 2.0 * fitted.sigma_px**2, 0.0, None), axis=0)
        shrunk = power / (power + 2.0 * fitted.sigma_px**2 + 1e-30) * fitted.amplitude
        # Half the square of an amplitude is its wave's mean square; both halves of the pieces are scored.
        before_power += 0.25 * np.sum(np.abs(scored.amplitude) ** 2, axis=1)
        after_power += 0.25 * np.sum(np.abs(scored.amplitude - shrunk) ** 2, axis=1)
        noise += 0.25 * np.sum(2.0 * scored.sigma_px**2, axis=1)
    return before_power, after_power, noise


def _of_jitter(common_variance: CommonRowVariance) -> tuple[Array, Array, Array]:
    """(pairs,) mean squares of the row means, px^2: before, minus the predicted part, and by noise alone."""
    noise = np.sum(common_variance.variance_px2, axis=1)
    before_power = np.sum(common_variance.variance_px2 * common_variance.ratio, axis=1)
    fold = np.arange(len(before_power)) % FOLDS
    predicted = np.zeros(len(before_power))
    for value in np.unique(fold):
        training = fold != value if (fold != value).any() else fold == value
        predicted[fold == value] = np.sum(common_variance.square_px2(training)[0]) * common_variance.frames[fold == value] / DETRENDED
    return (
        before_power,
        noise + abs(float(np.mean(before_power - noise - predicted))),
        noise,
    )  # over all pairs: what one has beyond another is noise
