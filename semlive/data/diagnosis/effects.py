"""Effects as a model stores them and as a diagnosis identifies them, with the tests that support them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


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
