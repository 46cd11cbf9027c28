"""Effect classes of the disparity maps: name, confounded effects, discriminating experiment and basis fields."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from semlive.data.diagnosis.effects import ParameterEstimate
from semlive.model.effects.run_geometry import Array, RunGeometry, slow_gaussian_process


@dataclass(frozen=True, slots=True, eq=False)
class ReportedParameter:
    """A physical parameter that is a linear function of the amplitudes of a basis field.

    Attributes:
        name: name of the parameter.
        unit: unit of its value.
        row: (q,) coefficients of the linear function.
    """

    name: str
    unit: str
    row: Array


@dataclass(frozen=True, slots=True, eq=False)
class BasisField:
    """Displacement field of an effect for given nonlinear parameters, up to its amplitudes.

    Attributes:
        field_px: (f, b, 2, q) displacement by unit amplitudes, about 1 px at its maximum.
        reported_parameters: physical parameters of the amplitudes.
        random_amplitude: (name, unit, factor) for random amplitudes: the parameter is their root mean square times the factor.
    """

    field_px: Array
    reported_parameters: tuple[ReportedParameter, ...] = ()
    random_amplitude: tuple[str, str, float] | None = None

    def rescaled_to(self, target: BasisField) -> BasisField:
        """The field with amplitudes scaled to those of a basis field of the same class in another run.

        The amplitude of a row time error, for example, is its largest displacement, which doubles with the row time. The field is unchanged
        if the reported parameters do not determine all amplitudes.
        """
        own_rows, target_rows = (
            np.array([reported_parameter.row for reported_parameter in basis_field.reported_parameters]) for basis_field in (self, target)
        )
        if own_rows.shape != target_rows.shape or own_rows.shape != (self.field_px.shape[-1],) * 2:
            return self
        scale, shape = np.linalg.solve(own_rows, target_rows), self.field_px.shape
        # One product takes 0.3 ms for 24,000 blocks with four amplitudes, and a product for each block 3.6 ms.
        field_px = (self.field_px.reshape(-1, shape[-1]) @ scale).reshape(shape)
        return replace(self, field_px=field_px, reported_parameters=target.reported_parameters)


Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class NonlinearParameter:
    """A nonlinear parameter: a time constant, a period, an instant or a position.

    Attributes:
        name: name of the parameter.
        unit: unit of its value.
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
    """Recurrence of an effect in another run on the same instrument."""

    SAME_AMPLITUDE = "the same amplitudes"
    NEW_DRAW = "independent amplitudes of the same size"
    FOLLOWS_MOVES = "independent amplitudes of the same size, in runs with moves"
    CONTINUES = "an independent time course with the same rate"
    ONE_TIME = "no recurrence"


@dataclass(frozen=True, slots=True)
class EffectClass:
    """An effect class of the dictionary.

    Attributes:
        name: canonical name.
        description: what happens, one sentence.
        basis_field: basis field for a run geometry and nonlinear parameters; None if it is not observable there.
        grid: values of the nonlinear parameters to test for a run geometry.
        nonlinear_parameters: nonlinear parameters, refined between the values of the grid.
        group: group of confounded effects, G1 ... G12, or None.
        discriminating_experiment: the experiment that separates it from those, one sentence.
        sizes_px: smallest and largest expected size of the amplitudes, px.
        strain_like: whether it resembles strain; then strain must not be corrected for it.
        alias_rule: names of special cases for given parameter values, the most likely first; empty if there are none.
        recurrence: recurrence in another run.
        linear_in_parameters: whether the basis field is a linear function of the nonlinear parameters.
        max_count: largest number of effects of this class in one run, each with its own parameters.
        discrete_parameters: parameters of the grid that are not refined, reported without uncertainty.
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
    max_count: int = 1
    discrete_parameters: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SlowDriftLaw:
    """Basis field of a shape with a slow random time course; its change from the start of frame 0 to the end is reported.

    Attributes:
        shape: (f, b, 2, 1) shape for a run geometry.
        parameter: name of the reported change.
        unit: unit of the change.
        per_px: change for an amplitude of 1 px.
    """

    shape: Callable[[RunGeometry], Array]
    parameter: str
    unit: str
    per_px: Callable[[RunGeometry], float] = field(default=lambda scene: 1.0 / scene.half_px)

    def __call__(self, scene: RunGeometry, values: Values) -> BasisField:
        """Basis field of the shape times slow random functions of time."""
        del values
        columns = slow_gaussian_process(scene.time_s)
        last = np.unravel_index(int(np.argmax(scene.time_s)), scene.time_s.shape)
        row = columns[last] * self.per_px(scene)
        return BasisField(self.shape(scene) * columns[:, :, None, :], (ReportedParameter(self.parameter, self.unit, row),))


def xy_parameters(unit: str, per_px: float = 1.0) -> tuple[ReportedParameter, ...]:
    """Reported parameters of the amplitudes of a shape along x and along y: ``x_<unit>`` and ``y_<unit>``."""
    name = unit.replace("/", "_per_").lower()
    return tuple(ReportedParameter(f"{axis}_{name}", unit, row * per_px) for axis, row in zip("xy", np.eye(2), strict=True))


def values_grid(name: str, values: Sequence[float]) -> Callable[[RunGeometry], Iterable[Values]]:
    """Return the grid of an effect with one nonlinear parameter that takes the same values in every run."""
    return lambda _: ({name: float(value)} for value in values)
