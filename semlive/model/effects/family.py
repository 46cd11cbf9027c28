"""What a nameable effect is: a name, what it is confounded with, what would decide, and the laws that it may follow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from semlive.data.diagnosis import FoundParameter
from semlive.model.effects.scene import Array, Scene, slowly


@dataclass(frozen=True, slots=True, eq=False)
class Reported:
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
class Law:
    """One way in which an effect may go, but for its size.

    Attributes:
        field_px: (f, b, 2, q) what unit amplitudes move, about 1 px where it is largest.
        reported: what the amplitudes mean.
        scatter: (name, unit, factor) where the amplitudes are random: their root mean square times the factor is the parameter.
    """

    field_px: Array
    reported: tuple[Reported, ...] = ()
    scatter: tuple[str, str, float] | None = None

    def meaning(self, other: Law) -> Law:
        """The same with amplitudes that mean what they mean in the same family's law on another scene.

        An error of a row time is told by what it moves at most, which is twice as much where rows take twice as long. As it is where what
        is reported does not tell all amplitudes.
        """
        own, wanted = (np.array([one.row for one in law.reported]) for law in (self, other))
        if own.shape != wanted.shape or own.shape != (self.field_px.shape[-1],) * 2:
            return self
        return replace(self, field_px=self.field_px @ np.linalg.solve(own, wanted), reported=other.reported)


Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Theta:
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


def _itself(parameters: Sequence[FoundParameter]) -> tuple[str, ...]:
    del parameters
    return ()


def _once(scene: Scene) -> Iterable[Values]:
    del scene
    return ({},)


class Again(Enum):
    """What another run on the same instrument has of an effect."""

    ALIKE = "the same amplitudes"
    ANEW = "amplitudes of the same size, drawn anew"
    BY_MOVES = "the same, where anything moves"
    GOING_ON = "a course drawn anew, at the same rate"
    ONCE = "nothing: it has happened"


@dataclass(frozen=True, slots=True)
class Family:
    """A nameable effect.

    Attributes:
        name: canonical.
        about: what happens, one sentence.
        law: on a scene, with values of what is not linear; None where it cannot be seen there.
        grid: the values that are tried on a scene.
        thetas: what is not linear and is refined between the values of the grid.
        group: of effects that it is confounded with, G1 ... G12, or None.
        decides: the experiment that tells it from those, one sentence.
        sizes_px: the least and the largest size that is expected of amplitudes.
        strain: whether it looks like strain, so that strain must not be corrected for it.
        told: names that parameters of such values have, the likeliest first; none if the effect has its own.
        again: what another run has of it.
        sums: whether a law is that of no value of anything plus, for each of the thetas, its value times what it adds at 1.
    """

    name: str
    about: str
    law: Callable[[Scene, Values], Law | None]
    grid: Callable[[Scene], Iterable[Values]] = _once
    thetas: tuple[Theta, ...] = ()
    group: str | None = None
    decides: str = ""
    sizes_px: tuple[float, float] = (0.003, 1.0)
    strain: bool = False
    told: Callable[[Sequence[FoundParameter]], tuple[str, ...]] = _itself
    again: Again = Again.ALIKE
    sums: bool = False


@dataclass(frozen=True, slots=True)
class Slow:
    """The law of a shape that wanders slowly in time; its change from the start of frame 0 to the end is reported.

    Attributes:
        shape: (f, b, 2, 1) on a scene.
        parameter: name of the change.
        unit: of the change.
        per_px: change for an amplitude of 1 px.
    """

    shape: Callable[[Scene], Array]
    parameter: str
    unit: str
    per_px: Callable[[Scene], float] = field(default=lambda scene: 1.0 / scene.half_px)

    def __call__(self, scene: Scene, values: Values) -> Law:
        """Any slow wandering."""
        del values
        columns = slowly(scene.time_s)
        last = np.unravel_index(int(np.argmax(scene.time_s)), scene.time_s.shape)
        row = columns[last] * self.per_px(scene)
        return Law(self.shape(scene) * columns[:, :, None, :], (Reported(self.parameter, self.unit, row),))


def along_each(unit: str, per_px: float = 1.0) -> tuple[Reported, ...]:
    """What the two amplitudes of a shape along x and along y mean: ``x_<unit>`` and ``y_<unit>``."""
    name = unit.replace("/", "_per_").lower()
    return tuple(Reported(f"{axis}_{name}", unit, row * per_px) for axis, row in zip("xy", np.eye(2), strict=True))
