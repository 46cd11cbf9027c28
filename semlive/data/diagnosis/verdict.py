"""The verdict of a diagnosis: outcome, identified effects, proposed experiments and the data of its figures."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.channels import IntensityDiagnosis, RowDiagnosis
from semlive.data.diagnosis.effects import DomainTest, HeldOutMisfit, IdentifiedEffect, ModelEffect, Outcome

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ExperimentForecast:
    """What an experiment is expected to decide.

    Attributes:
        kind: of it: parked, again, longer_hold, dummy_steps, unload, reversed or other_scan.
        dwell: its dwell and row times, of those of the run before it.
        minutes: of beam time.
        log_odds: expected logarithm of the odds that it gives for the effect that is true, of those two that are hardest to tell apart.
        true: the one of these two that is taken for true.
        other: the other, or ``nothing``.
    """

    kind: str
    dwell: float
    minutes: float
    log_odds: float
    true: str
    other: str

    @property
    def summary(self) -> str:
        """The experiment in words."""
        return self.kind.replace("_", " ") + ("" if self.dwell == 1.0 else f", {self.dwell:g} times the dwell")

    @property
    def log_odds_per_minute(self) -> float:
        """Logarithm of the odds for a minute of beam time."""
        return self.log_odds / self.minutes


@dataclass(frozen=True, slots=True)
class ExperimentProposal:
    """What would decide between effects.

    Attributes:
        between: their names.
        about: what to do, one sentence.
        foretold: what experiments that need nothing the run did not have are expected to decide, the most for a minute first.
    """

    between: tuple[str, ...]
    about: str
    foretold: tuple[ExperimentForecast, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class EffectProfile:
    """How much of an effect's shape each frame shows, beside what the model says.

    Attributes:
        name: of the effect.
        abscissa: what the frames are told apart by: ``time`` or ``load``.
        at: (f,) seconds after the start of frame 0, or N.
        data_px: (f,) as measured, all other effects taken off.
        sigma_px: (f,) standard uncertainty.
        model_px: (f,) as the effect has it.
    """

    name: str
    abscissa: str
    at: Values
    data_px: Values
    sigma_px: Values
    model_px: Values


@dataclass(frozen=True, slots=True)
class StrainBias:
    """What an effect adds to the mean strain under load.

    Attributes:
        name: of the effect.
        exx, eyy, exy: at the highest load.
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
    """What a verdict looks like.

    Attributes:
        x_px: (b,) columns of the blocks' centres.
        y_px: (b,) rows.
        frame: (k,) numbers of frames that nothing was fitted on but how the specimen lay in them.
        before: (k, b, 2) what the baseline leaves of them, in standard deviations of the noise.
        after: (k, b, 2) the same with the effects, their amplitudes being those of the other pairs.
        profiles: of each effect.
        on_strain: of each effect.
        quantiles: (n, 2) of what is left, whitened: of a normal distribution, and found.
        frame_autocorrelation: correlation of what is left with the next frame, and what it scatters by.
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
    "baseline_drift_underresolved": "the drift is finer than its knots; what it left was told apart before anything was named",
    "baseline_distortion_underresolved": "the distortion is finer than its knots; what it left was told apart before anything was named",
}
"""What is said of the baseline's splines where they are too coarse, by the names that have no effect of their own."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The verdict.

    Attributes:
        outcome: how it ended.
        effects: that were named, the first one first; of an UNKNOWN the closest.
        ambiguous: names that would do as well, the effects' own among them; empty unless AMBIGUOUS.
        group: of confounded effects, G1 ... G12, or None.
        experiment: what would decide, or None.
        gap: on held-out pairs; None where nothing was named.
        where: all domains, before any effect.
        noise_px: standard deviation of a block's mean in one frame.
        evidence: before any effect was added, each name with the logarithm of its Bayes factor; those without a name among them.
        model_effects: effects that were in the model before.
        duration_s: when the last point was scanned, seconds after the start of frame 0.
        size_px: width and height of the frames.
        rows: what rows show; their effects and domains are among those above.
        rows_unavailable: why there is no row channel, one sentence; empty if there is one.
        figure_data: what it looks like; None where nothing was named in the maps.
        grey: what grey levels show; their effects and domain are among those above.
        intensity_unavailable: why there is no channel of grey levels, one sentence; empty if there is one.
        overlap: each other name with the share of the first effect in the maps that it could take over; none where nothing was named.
        coarse: the baseline's splines that are too coarse for the run, ``baseline_drift_underresolved`` or
            ``baseline_distortion_underresolved``: what they left was added to the baseline before anything was named.
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
    duration_s: float = 0.0
    size_px: tuple[int, int] = (0, 0)
    rows: RowDiagnosis | None = None
    rows_unavailable: str = ""
    figure_data: DiagnosisFigureData | None = field(default=None, compare=False)
    overlap: tuple[tuple[str, float], ...] = ()
    grey: IntensityDiagnosis | None = None
    intensity_unavailable: str = ""
    coarse: tuple[str, ...] = ()
