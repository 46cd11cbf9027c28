"""Interface of an effect: a name, a number of parameters, and columns of the design matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Axis(Enum):
    """Component of the position that a column changes."""

    EACH = "each"
    """x and y with separate parameters: index i means parameter 2 i for x and 2 i + 1 for y."""
    X = "x"
    Y = "y"


@dataclass(frozen=True, slots=True, eq=False)
class FrameObservation:
    """Scan addresses and times at which one frame observed n material points.

    Attributes:
        frame: number of the frame.
        pair: number of its pair.
        x_px: (n,) scan address, column.
        y_px: (n,) scan address, row.
        visit_time_s: (visits, n) scan times, seconds after the start of frame 0.
        ideal_px: (n, 2) ideal position in pair 0 relative to the image centre, or None where no effect needs it.
        rotation_rad: rotation of the specimen since pair 0 for linearisation; 0 if its motion is not known to be rigid.
        drift_px: (n, 2) drift at the scan times, if it advects the distortion; else None.
    """

    frame: int
    pair: int
    x_px: NDArray[np.float64]
    y_px: NDArray[np.float64]
    visit_time_s: NDArray[np.float64]
    ideal_px: NDArray[np.float64] | None = None
    rotation_rad: float = 0.0
    drift_px: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Part of the design matrix in local form: row r has ``value[r, j]`` at parameter ``index[r, j]``.

    Attributes:
        axis: changed component of the position.
        index: (n, k) index within the effect's own parameters (see Axis.EACH).
        value: (n, k) px per unit of the parameter.
    """

    axis: Axis
    index: NDArray[np.int64]
    value: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TensorColumns:
    """Columns that are a product of one row over x and one over y, as those of a surface; `index` and `value` as in `Columns`.

    Attributes:
        axis: changed component of the position.
        index_x: (n, kx) index along x.
        value_x: (n, kx) factor along x.
        index_y: (n, ky) index along y.
        value_y: (n, ky) factor along y.
        shape: (ny, nx) of the coefficients; coefficient (iy, ix) is ``iy * nx + ix``.
    """

    axis: Axis
    index_x: NDArray[np.int64]
    value_x: NDArray[np.float64]
    index_y: NDArray[np.int64]
    value_y: NDArray[np.float64]
    shape: tuple[int, int]

    @property
    def index(self) -> NDArray[np.int64]:
        """(n, ky kx) index within the effect's own parameters."""
        return (self.index_y[:, :, None] * self.shape[1] + self.index_x[:, None, :]).reshape(len(self.index_x), -1)

    @property
    def value(self) -> NDArray[np.float64]:
        """(n, ky kx) px per unit of the parameter."""
        return (self.value_y[:, :, None] * self.value_x[:, None, :]).reshape(len(self.value_x), -1)


class Effect(Protocol):
    """Displacement of the scan address of a material point, linear in its parameters."""

    @property
    def name(self) -> str:
        """The effect's name, unique within a model."""
        ...

    @property
    def size(self) -> int:
        """Number of parameters; an effect grows only by appending parameters."""
        ...

    @property
    def needs_ideal(self) -> bool:
        """Whether the columns depend on the ideal position, which is itself estimated (so they are re-linearised)."""
        ...

    def columns(self, observation: FrameObservation) -> tuple[Columns | TensorColumns, ...]:
        """Columns of the effect for the points of an observation."""
        ...


@dataclass(frozen=True, slots=True)
class Layout:
    """Index range of the parameters of each effect in the joint parameter vector.

    Attributes:
        names: names of the effects in order.
        sizes: numbers of their parameters.
    """

    names: tuple[str, ...]
    sizes: tuple[int, ...]

    @classmethod
    def of(cls, model: Sequence[Effect]) -> Layout:
        """The layout of a model."""
        return cls(tuple(effect.name for effect in model), tuple(effect.size for effect in model))

    @property
    def size(self) -> int:
        """Number of parameters of the model."""
        return sum(self.sizes)

    def part(self, name: str) -> slice:
        """The slice of the effect called `name`."""
        at = self.names.index(name)
        start = sum(self.sizes[:at])
        return slice(start, start + self.sizes[at])

    def of_each(self) -> tuple[tuple[str, int], ...]:
        """Name and number of parameters of each effect."""
        return tuple(zip(self.names, self.sizes, strict=True))

    def within(self, larger: Layout) -> NDArray[np.int64]:
        """(size,) index of each parameter in a layout to which effects have appended parameters."""
        starts = [larger.part(name).start for name in self.names]
        return np.concatenate([start + np.arange(size) for start, size in zip(starts, self.sizes, strict=True)]).astype(np.int64)
