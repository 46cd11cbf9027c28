"""The verdict of a diagnosis: outcome, identified effects, proposed experiments and the data of its figures."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.channels import IntensityDiagnosis, RowDiagnosis
from semlive.data.diagnosis.effects import DomainTest, HeldOutMisfit, IdentifiedEffect, ModelEffect, Outcome
from semlive.data.diagnosis.misfit_reason import MisfitReason

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ExperimentForecast:
    """Expected log-odds of one proposed experiment.

    Attributes:
        kind: parked (stationary series), again (repeat), longer_hold, dummy_steps (zero-load steps), unload, reversed or other_scan.
        dwell: dwell and row times, as a multiple of those of the diagnosed run.
        minutes: beam time, minutes.
        log_odds: expected log-odds for the true one of the two effects that are hardest to separate.
        true: name of the effect that is assumed true.
        other: name of the rival effect, or ``nothing``.
    """

    kind: str
    dwell: float
    minutes: float
    log_odds: float
    true: str
    other: str

    @property
    def summary(self) -> str:
        """Description of the experiment for reports."""
        return self.kind.replace("_", " ") + ("" if self.dwell == 1.0 else f", {self.dwell:g} times the dwell")

    @property
    def log_odds_per_minute(self) -> float:
        """Expected log-odds per minute of beam time."""
        return self.log_odds / self.minutes


@dataclass(frozen=True, slots=True)
class ExperimentProposal:
    """An experiment that separates the remaining candidates.

    Attributes:
        between: names of the candidates.
        about: what to do, one sentence.
        forecasts: forecasts for experiments with the equipment of the run, in descending order of log-odds per minute.
    """

    between: tuple[str, ...]
    about: str
    forecasts: tuple[ExperimentForecast, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class EffectProfile:
    """Amplitude of an effect's basis field in each frame, as measured and by the model.

    Attributes:
        name: name of the effect.
        abscissa: quantity of the abscissa: ``time`` or ``load``.
        at: (f,) abscissa: seconds after the start of frame 0, or N.
        data_px: (f,) measured amplitude, all other effects subtracted.
        sigma_px: (f,) standard uncertainty.
        model_px: (f,) amplitude by the fitted effect.
    """

    name: str
    abscissa: str
    at: Values
    data_px: Values
    sigma_px: Values
    model_px: Values


@dataclass(frozen=True, slots=True)
class StrainBias:
    """Bias of the mean strain under load by an effect.

    Attributes:
        name: name of the effect.
        exx, eyy, exy: bias of the strain components at the highest load.
        modulus_change: relative change of Young's modulus by a correction, or None without loads.
        poissons_ratio_change: change of Poisson's ratio by a correction, or None.
    """

    name: str
    exx: float
    eyy: float
    exy: float
    modulus_change: float | None
    poissons_ratio_change: float | None


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisFigureData:
    """Data for the figures of a verdict.

    Attributes:
        x_px: (b,) columns of the block centres.
        y_px: (b,) rows of the block centres.
        frame: (k,) numbers of held-out frames; only the motion of the specimen was fitted in them.
        before: (k, b, 2) residual of the baseline model, in standard deviations of the noise.
        after: (k, b, 2) residual with the effects, their amplitudes fitted to the other pairs.
        profiles: profile of each effect.
        on_strain: strain bias of each effect.
        quantiles: (n, 2) quantiles of a normal distribution and of the whitened residual.
        frame_autocorrelation: correlation of the residuals of successive frames, and its standard deviation.
    """

    x_px: Values
    y_px: Values
    frame: tuple[int, ...]
    before: Values
    after: Values
    profiles: tuple[EffectProfile, ...]
    on_strain: tuple[StrainBias, ...]
    quantiles: Values
    frame_autocorrelation: tuple[float, float]


UNDERRESOLVED = {
    "baseline_drift_underresolved": "the drift varies faster than its knots; its residual was added to the baseline before the search",
    "baseline_drift_underresolved_in_frames": (
        "the drift in each frame varies faster than its knots; its residual was added to the baseline before the search"
    ),
    "baseline_distortion_underresolved": "the distortion is finer than its knots; its residual was added to the baseline before the search",
}
"""Messages about splines of the baseline that are too coarse, by name."""


@dataclass(frozen=True, slots=True)
class ImageVerdicts:
    """Verdicts of the channels that need images; `Diagnosis.effects` and `Diagnosis.where` include their effects and tests.

    Attributes:
        rows: verdict of the row channel.
        no_rows: reason for a missing row channel; empty if there is one.
        grey: verdict of the intensity channel.
        no_grey: reason for a missing intensity channel; empty if there is one.
    """

    rows: RowDiagnosis | None = None
    no_rows: str = ""
    grey: IntensityDiagnosis | None = None
    no_grey: str = ""


@dataclass(frozen=True, slots=True)
class AdequacyTest:
    """Test whether the residual with all effects of a verdict is noise: the test of the live warning and of replay.

    Attributes:
        domain: domain with the smallest p-value.
        p_value: family-wise, over all domains.
        rms_px: root mean square of the residual in the domain.
        significance_level: largest p-value that counts as significant.
    """

    domain: str
    p_value: float
    rms_px: float
    significance_level: float

    @property
    def passed(self) -> bool:
        """Whether the residual is consistent with noise, the own bias of the correlation and harmless residuals."""
        return self.p_value > self.significance_level


@dataclass(frozen=True, slots=True)
class OutsideTest:
    """Conformal test of the maps for anything outside the catalogue, such as an unlisted effect.

    Attributes:
        p_value: with at most listed effects, an outcome like this or further from them has at most this probability.
        experiments: number of simulated experiments in the calibration.
    """

    p_value: float
    experiments: int


@dataclass(frozen=True, slots=True)
class RunExtent:
    """Time and frame size of a run.

    Attributes:
        duration_s: time of the last scanned point, seconds after the start of frame 0.
        size_px: width and height of the frames.
        pairs: number of pairs in the diagnosis, and in the run; a run longer than one matrix is thinned.
    """

    duration_s: float = 0.0
    size_px: tuple[int, int] = (0, 0)
    pairs: tuple[int, int] = (0, 0)


SETTLING_LAWS = {
    "row": ("flyback_settling", "row_start_settling_in_position"),
    "frame": ("frame_start_settling", "frame_start_settling_in_position"),
}
"""Laws of settling at the start of rows and frames that frames of one magnification and one dwell cannot separate."""
SETTLING_DECISION = "other_magnification"
"""Experiment that separates them."""


def settling_text(start: str) -> str:
    """What a run cannot show of the settling at a start, and the experiment that decides, one sentence."""
    return (
        f"settling at the {start} start, if there is any, is part of the distortion and corrected here; one magnification and one dwell "
        f"cannot separate {' from '.join(SETTLING_LAWS[start])}, so its extent at another magnification or dwell is unknown: "
        f"`semlive experiment propose --kind {SETTLING_DECISION}` decides"
    )


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The verdict of a diagnosis.

    Attributes:
        outcome: outcome over all channels.
        effects: identified effects in the order of selection; for UNKNOWN the most likely effect.
        ambiguous: names of all candidates that explain the data equally well; empty unless AMBIGUOUS.
        group: group of confounded effects, G1 ... G12, or None.
        experiment: proposed experiment, or None.
        gap: misfit on held-out pairs; None if no effect was identified.
        where: residual tests of all domains, before any effect.
        noise_px: standard deviation of the mean of a block in one frame.
        evidence: names and logarithms of the Bayes factors of all candidates, before any effect, including unnamed fields.
        model_effects: effects that the model contained before the diagnosis.
        figure_data: data for figures; None if no effect was identified in the maps.
        overlap: names of the other candidates, with the fraction of the first map effect that each explains; empty if none was identified.
        coarse: splines of the baseline that are too coarse for the run, by their names in `UNDERRESOLVED`; their residual was added to the
            baseline before the search.
        images: verdicts of the image channels.
        run: extent of the diagnosed run.
        truncated: whether the search for effects ended at the limit of its work, so that effects may be missing.
        adequacy: test of the residual of the maps with all effects; None if it was not possible.
        closest: for UNKNOWN, names of the most likely single effects, and the share of the gap that each closes alone; none is found.
        outside: test of the maps for anything outside the catalogue; None if the maps were tested again with a wave.
        unexplained: for UNKNOWN, the criteria that failed.
    """

    outcome: Outcome
    effects: tuple[IdentifiedEffect, ...]
    ambiguous: tuple[str, ...]
    group: str | None
    experiment: ExperimentProposal | None
    gap: HeldOutMisfit | None
    where: tuple[DomainTest, ...]
    noise_px: float
    evidence: tuple[tuple[str, float], ...] = ()
    model_effects: tuple[ModelEffect, ...] = ()
    figure_data: DiagnosisFigureData | None = field(default=None, compare=False)
    overlap: tuple[tuple[str, float], ...] = ()
    coarse: tuple[str, ...] = ()
    images: ImageVerdicts = ImageVerdicts()
    run: RunExtent = RunExtent()
    truncated: bool = False
    adequacy: AdequacyTest | None = None
    closest: tuple[tuple[str, float], ...] = ()
    outside: OutsideTest | None = None
    unexplained: tuple[MisfitReason, ...] = ()

    @property
    def further_misfit(self) -> tuple[MisfitReason, ...]:
        """Criteria that failed, without the one that `adequacy` states with more detail."""
        domain = None if self.adequacy is None or self.adequacy.passed else self.adequacy.domain
        return tuple(reason for reason in self.unexplained if domain not in (reason.name, reason.criterion.value))
