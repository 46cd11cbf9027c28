"""Effects as a model stores them and as a diagnosis identifies them, with the tests that support them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Outcome(StrEnum):
    """Outcome of a diagnosis."""

    NONE = "NONE"
    """The data show no missing effect."""
    IDENTIFIED = "IDENTIFIED"
    AMBIGUOUS = "AMBIGUOUS"
    """An effect is missing; several candidates explain the data, and an experiment is proposed that separates them."""
    UNKNOWN = "UNKNOWN"
    """The residual is significant, but no effect of the dictionary explains it."""
    REJECTED = "REJECTED"
    """The most likely effect does not explain held-out pairs."""


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """A parameter of an effect.

    Attributes:
        name: name of the parameter.
        value: most likely value.
        sigma: standard uncertainty.
        unit: unit of value and sigma.
        alternatives: further values that the data do not exclude, with their standard uncertainties, the most likely first.
    """

    name: str
    value: float
    sigma: float
    unit: str
    alternatives: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class ModelEffect:
    """An effect of a model, with the values that predict it in any run.

    Attributes:
        name: canonical name.
        values: nonlinear parameters by name.
        size_px: prior standard deviation of its amplitudes.
    """

    name: str
    values: tuple[tuple[str, float], ...]
    size_px: float


@dataclass(frozen=True, slots=True)
class EffectModel:
    """Effects identified before a run, and the frames in which they were identified.

    Attributes:
        effects: in addition to raster time, drift, distortion and motion; empty for the default model.
        size_px: width and height of those frames; None if the file does not contain them.
        pixel_size_um: pixel size of those frames; None if the file does not contain it.
        sha256: SHA-256 of the model file.
    """

    effects: tuple[ModelEffect, ...] = ()
    size_px: tuple[int, int] | None = None
    pixel_size_um: float | None = None
    sha256: str | None = None


EMPTY_MODEL = EffectModel()


@dataclass(frozen=True, slots=True)
class IdentifiedEffect:
    """An effect that the data support.

    Attributes:
        name: canonical name.
        parameters: physical parameters with their uncertainties.
        peak_px: largest displacement by the effect at any point.
        log_bayes_factor: natural logarithm of the Bayes factor for the effect.
        p_value: probability of an equally large Bayes factor for any effect without a missing effect.
        strain: whether its displacement resembles strain; then it must not be corrected.
        model_effect: the effect in the form of a model file.
        amplitudes_px: most likely amplitudes.
        covariance_px2: covariance of the amplitudes.
        strain_attenuation: largest fraction of an injected strain that a correction for the effect removes.
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
    strain_attenuation: float = 0.0

    @property
    def modulus_bias(self) -> ParameterEstimate | None:
        """Relative change of Young's modulus by a correction; None if it is not a parameter."""
        return next((parameter for parameter in self.parameters if parameter.name == "modulus_change"), None)


@dataclass(frozen=True, slots=True)
class HeldOutMisfit:
    """Misfit on pairs excluded from the fit, root mean squares of block means.

    Attributes:
        before_px: misfit without the effects.
        after_px: misfit with the effects.
        floor_px: misfit by noise alone.
        closure: fraction of the excess misfit (in squares) that the effects explain.
        closure_interval: 95 % interval of the explained fraction.
        gain_in_sigmas: reduction of the misfit, in its standard errors.
        log_odds: log-odds by this reduction for the effects, against effects unrelated to these pairs.
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
    """Test of the residual in one domain.

    Attributes:
        domain: disparity maps: space, row, row_start, scan_time, frame, load, fraction or spatial_lines, which is tested with all effects;
            row channel: row_waves, row_common and map_waves; stage: moves; load cell: load_readings; strain gage: gage_readings; grey
            levels: intensity, which has no displacement.
        p_value: family-wise, over all domains.
        rms_px: root mean square of the residual in the domain.
    """

    domain: str
    p_value: float
    rms_px: float
