"""What diagnosis says: where model and data disagree, what is missing, and how much of the gap it closes."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


class Outcome(StrEnum):
    """How a diagnosis ends."""

    NONE = "NONE"
    """Nothing is missing that these data could show."""
    IDENTIFIED = "IDENTIFIED"
    AMBIGUOUS = "AMBIGUOUS"
    """Something is missing; several effects would do, and an experiment is named that decides."""
    UNKNOWN = "UNKNOWN"
    """Something is missing that no known effect explains."""
    REJECTED = "REJECTED"
    """The best effect does not explain pairs that it was not fitted on."""


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """A parameter of an effect.

    Attributes:
        name: of it.
        value: most likely.
        sigma: standard uncertainty.
        unit: of both.
    """

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True, slots=True)
class ModelEffect:
    """An effect as a model has it: enough to predict it in any run.

    Attributes:
        name: canonical.
        values: of what is not linear in it, by name.
        size_px: standard deviation of its amplitudes before the data.
    """

    name: str
    values: tuple[tuple[str, float], ...]
    size_px: float


@dataclass(frozen=True, slots=True)
class EffectModel:
    """Effects that are known before a run, and what they were found in.

    Attributes:
        effects: beside raster time, drift, distortion and motion; none is the model that every run begins with.
        size_px: width and height of the frames that they were found in, None if the file does not tell.
        pixel_size_um: of those frames, None if the file does not tell.
        sha256: of the file.
    """

    effects: tuple[ModelEffect, ...] = ()
    size_px: tuple[int, int] | None = None
    pixel_size_um: float | None = None
    sha256: str | None = None


EMPTY_MODEL = EffectModel()


@dataclass(frozen=True, slots=True)
class IdentifiedEffect:
    """An effect that the data ask for.

    Attributes:
        name: canonical.
        parameters: what is known of it.
        peak_px: the largest displacement that it causes anywhere.
        log_bayes_factor: how much likelier the data are with it, natural logarithm.
        p_value: share of data without it that would ask for any effect as loudly.
        strain: whether it looks like strain, which must then not be corrected for it.
        model_effect: the same for a model.
        amplitudes_px: most likely.
        covariance_px2: of the amplitudes.
        strain_eaten: largest share of an injected strain that a correction for the effect would take away.
    """

    name: str
    parameters: tuple[ParameterEstimate, ...]
    peak_px: float
    log_bayes_factor: float
    p_value: float
    strain: bool
    model_effect: ModelEffect
    amplitudes_px: tuple[float, ...] = ()
    covariance_px2: tuple[tuple[float, ...], ...] = ()
    strain_eaten: float = 0.0

    @property
    def modulus_bias(self) -> ParameterEstimate | None:
        """What a correction would change of Young's modulus, relative; None where that is not among the parameters."""
        return next((one for one in self.parameters if one.name == "modulus_change"), None)


@dataclass(frozen=True, slots=True)
class HeldOutMisfit:
    """Misfit on pairs that the effects were not fitted on, root mean squares of block means.

    Attributes:
        before_px: without the effects.
        after_px: with them.
        floor_px: what noise alone leaves.
        closure: share of the gap (in squares) that the effects close.
        closure_interval: 95 % interval of the share.
        gain_in_sigmas: what they gain, in its own standard errors.
        log_odds: logarithm of the odds that the gain gives for the effects, against effects that have nothing to do with these pairs.
    """

    before_px: float
    after_px: float
    floor_px: float
    closure: float
    closure_interval: tuple[float, float]
    gain_in_sigmas: float
    log_odds: float = 0.0


@dataclass(frozen=True, slots=True)
class DomainTest:
    """One domain in which model and data may disagree.

    Attributes:
        domain: space, row, row_start, scan_time, frame, load or fraction; of the row channel row_waves and row_common, of the stage moves,
            of the load cell load_readings, of a strain gage gage_readings, of grey levels intensity, which moves nothing.
        p_value: family-wise, over all domains.
        rms_px: size of what disagrees there.
    """

    domain: str
    p_value: float
    rms_px: float


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


@dataclass(frozen=True, slots=True)
class RowDiagnosis:
    """What rows show that were registered by themselves: disparity maps average it over a subset.

    Attributes:
        outcome: of this channel.
        effects: that were named, or the closest.
        ambiguous: names that would do as well.
        gap: on what they were not fitted on; None where nothing was named.
        where: the two domains of rows, before any effect.
        evidence: before any effect was added, each name with the logarithm of its Bayes factor.
        pairs: that were looked at.
        rows: of each, at most.
        noise_px: standard deviation of a row's shift by noise alone.
        frequency_hz: of the spectrum, thinned to its peaks.
        power: there, a mean over pairs and axes in units of the noise.
        detection_threshold: power that one spectrum of noise in a hundred reaches anywhere.
    """

    outcome: Outcome
    effects: tuple[IdentifiedEffect, ...]
    ambiguous: tuple[str, ...]
    gap: HeldOutMisfit | None
    where: tuple[DomainTest, ...]
    evidence: tuple[tuple[str, float], ...]
    pairs: int
    rows: int
    noise_px: float
    frequency_hz: tuple[float, ...]
    power: tuple[float, ...]
    detection_threshold: float


@dataclass(frozen=True, slots=True)
class IntensityHistory:
    """How a quantity of the grey levels went over a run.

    Attributes:
        name: mean, gain, curvature or blur, against frame 1.
        unit: of it.
        value: of each frame.
        sigma: standard uncertainty of each.
        fitted: what the laws that were found make of it.
    """

    name: str
    unit: str
    value: tuple[float, ...]
    sigma: float
    fitted: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class IntensityDiagnosis:
    """What grey levels show: the tone and the sharpness of every frame against the first pair, on the same material.

    Attributes:
        outcome: of this channel.
        effects: that were named, or nothing.
        ambiguous: names that would do as well.
        where: the domain of intensity, before any effect.
        evidence: before any effect was added, each name with the logarithm of its Bayes factor.
        frames: that were looked at.
        blocks: of the specimen in each.
        noise: a and b of the variance a + b I of a pixel, grey levels squared and grey levels, each with its standard uncertainty.
        mean_levels: of the picture.
        contrast_levels: of the pattern.
        clipped: largest share of black or white pixels in a frame.
        time_s: middle of each frame's scan, seconds after the start of frame 0.
        histories: over those frames.
        left: what no law explains, one sentence; empty if nothing is left.
    """

    outcome: Outcome
    effects: tuple[IdentifiedEffect, ...]
    ambiguous: tuple[str, ...]
    where: tuple[DomainTest, ...]
    evidence: tuple[tuple[str, float], ...]
    frames: int
    blocks: int
    noise: tuple[ParameterEstimate, ParameterEstimate]
    mean_levels: float
    contrast_levels: float
    clipped: float
    time_s: tuple[float, ...]
    histories: tuple[IntensityHistory, ...]
    left: str = ""


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


@dataclass(frozen=True, slots=True)
class SharedEffect:
    """An effect that runs with different scans show.

    Attributes:
        name: canonical.
        aliases: that it has by its parameters, the likeliest first.
        peak_px: the largest displacement that it causes at any point of any run; 0 where each run has its own.
        parameters: what is known of it; none where each run has its own.
    """

    name: str
    aliases: tuple[str, ...]
    peak_px: float
    parameters: tuple[ParameterEstimate, ...]


@dataclass(frozen=True, slots=True)
class ScanRotation:
    """What two runs say of which the second's scan was turned.

    Attributes:
        angle_rad: of the scan, x towards y positive.
        x_excess: of the scan's axes: u = e (x - xc), whether it has a name or not.
        skew: of them: u = skew (y - yc).
        follows: what the distortion goes with: ``column``, ``scan``, ``both``, ``neither``; empty where that cannot be told.
        of_scan: logarithm of the odds that some of it goes with the scan, against none.
    """

    angle_rad: ParameterEstimate
    x_excess: ParameterEstimate
    skew: ParameterEstimate
    follows: str
    of_scan: float


@dataclass(frozen=True, slots=True)
class TwoRunVerdict:
    """What runs with different scans say together.

    Attributes:
        outcome: NONE, IDENTIFIED, AMBIGUOUS or UNKNOWN.
        effect: the likeliest, or None.
        ambiguous: the names that would do, if more than one would.
        evidence: by name, the logarithm of the Bayes factor; the loudest first.
        apart: logarithm of the odds for a distortion of its own in each run against one for all.
        effects: that have a name, the likeliest first; only a turned scan shows more than one.
        turned: what the turn of a scan shows; None where none was turned.
    """

    outcome: Outcome
    effect: SharedEffect | None
    ambiguous: tuple[str, ...]
    evidence: tuple[tuple[str, float], ...]
    apart: float
    effects: tuple[SharedEffect, ...] = ()
    turned: ScanRotation | None = None
