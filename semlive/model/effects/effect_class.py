"""What a nameable effect is: a name, what it is confounded with, what would decide, and the laws that it may follow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from semlive.data.diagnosis.effects import ParameterEstimate
from semlive.model.effects.run_geometry import Array, RunGeometry, slow_gaussian_process


@dataclass(frozen=True, slots=True, eq=False)
class ReportedParameter:
    """A linear function of a law's amplitudes that people know by a name.

    Attributes:
        name: of the parameter.
        unit: of its value.
        row: (q,) the function.
    """

    name: str
    unit: str
    row: Array


@dataclass(frozen=True, slots=True, eq=False)
class BasisField:
    """One way in which an effect may go, but for its size.

    Attributes:
        field_px: (f, b, 2, q) what unit amplitudes move, about 1 px where it is largest.
        reported_parameters: what the amplitudes mean.
        random_amplitude: (name, unit, factor) where the amplitudes are random: their root mean square times the factor is the parameter.
    """

    field_px: Array
    reported_parameters: tuple[ReportedParameter, ...] = ()
    random_amplitude: tuple[str, str, float] | None = None

    def rescaled_to(self, other: BasisField) -> BasisField:
        """The same with amplitudes that mean what they mean in the same family's law on another scene.

        An error of a row time is told by what it moves at most, which is twice as much where rows take twice as long. As it is where what
        is reported does not tell all amplitudes.
        """
        own, target = (
            np.array([reported_parameter.row for reported_parameter in basis_field.reported_parameters]) for basis_field in (self, other)
        )
        if own.shape != target.shape or own.shape != (self.field_px.shape[-1],) * 2:
            return self
        return replace(self, field_px=self.field_px @ np.linalg.solve(own, target), reported_parameters=other.reported_parameters)


Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class NonlinearParameter:
    """A parameter that is not linear: a time constant, a period, an instant, a place.

    Attributes:
        name: of the parameter.
        unit: of its value.
        step: distance of neighbouring values on the grid: a factor if `ratio`, else a difference.
        ratio: whether neighbours differ by a factor.
    """

    name: str
    unit: str
    step: float
    ratio: bool = False


def _itself(parameters: Sequence[ParameterEstimate]) -> tuple[str, ...]:
    del parameters
    return ()


def _once(scene: RunGeometry) -> Iterable[Values]:
    del scene
    return ({},)


class Recurrence(Enum):
    """What another run on the same instrument has of an effect."""

    SAME_AMPLITUDE = "the same amplitudes"
    NEW_DRAW = "amplitudes of the same size, drawn anew"
    FOLLOWS_MOVES = "the same, where anything moves"
    CONTINUES = "a course drawn anew, at the same rate"
    ONE_TIME = "nothing: it has happened"


@dataclass(frozen=True, slots=True)
class EffectClass:
    """A nameable effect.

    Attributes:
        name: canonical.
        description: what happens, one sentence.
        law: on a scene, with values of what is not linear; None where it cannot be seen there.
        grid: the values that are tried on a scene.
        nonlinear_parameters: what is not linear and is refined between the values of the grid.
        group: of effects that it is confounded with, G1 ... G12, or None.
        discriminating_experiment: the experiment that tells it from those, one sentence.
        sizes_px: the least and the largest size that is expected of amplitudes.
        strain_like: whether it looks like strain, so that strain must not be corrected for it.
        alias_rule: names that parameters of such values have, the likeliest first; none if the effect has its own.
        recurrence: what another run has of it.
        linear_in_parameters: whether a law is that of no value of anything plus, for each of the thetas, its value times what it adds at 1.
    """

    name: str
    description: str
    basis_field: Callable[[RunGeometry, Values], BasisField | None]
    grid: Callable[[RunGeometry], Iterable[Values]] = _once
    nonlinear_parameters: tuple[NonlinearParameter, ...] = ()
    group: str | None = None
    discriminating_experiment: str = ""
    sizes_px: tuple[float, float] = (0.003, 1.0)
    strain_like: bool = False
    alias_rule: Callable[[Sequence[ParameterEstimate]], tuple[str, ...]] = _itself
    recurrence: Recurrence = Recurrence.SAME_AMPLITUDE
    linear_in_parameters: bool = False


@dataclass(frozen=True, slots=True)
class SlowDriftLaw:
    """The law of a shape that wanders slowly in time; its change from the start of frame 0 to the end is reported.

    Attributes:
        shape: (f, b, 2, 1) on a scene.
        parameter: name of the change.
        unit: of the change.
        per_px: change for an amplitude of 1 px.
    """

    shape: Callable[[RunGeometry], Array]
    parameter: str
    unit: str
    per_px: Callable[[RunGeometry], float] = field(default=lambda scene: 1.0 / scene.half_px)

    def __call__(self, scene: RunGeometry, values: Values) -> BasisField:
        """Any slow wandering."""
        del values
        columns = slow_gaussian_process(scene.time_s)
        last = np.unravel_index(int(np.argmax(scene.time_s)), scene.time_s.shape)
        row = columns[last] * self.per_px(scene)
        return BasisField(self.shape(scene) * columns[:, :, None, :], (ReportedParameter(self.parameter, self.unit, row),))


def xy_parameters(unit: str, per_px: float = 1.0) -> tuple[ReportedParameter, ...]:
    """What the two amplitudes of a shape along x and along y mean: ``x_<unit>`` and ``y_<unit>``."""
    name = unit.replace("/", "_per_").lower()
    return tuple(ReportedParameter(f"{axis}_{name}", unit, row * per_px) for axis, row in zip("xy", np.eye(2), strict=True))
