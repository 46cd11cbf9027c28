"""Distortion: a static field at the scan address, a tensor-product spline per component."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semlive.data.grid import Grid
from semlive.kernels.splines.spline_columns import evaluate_surface
from semlive.model.effect import Axis, FrameObservation, TensorColumns
from semlive.model.knots import KnotSpline, towards_start
from semlive.model.splines import UniformSpline

# Distortion is smooth over most of the frame. With a knot distance of 100 px a cubic spline has a residual of 1e-4 px for a wave of 1100
# px, 5e-6 of false strain between two points; a quintic spline with the same knots has 3e-7 px.
DEGREE = 5
# At the start of a row the beam is still settling: its error decays within 5 to 200 px. Therefore the knot distance is halved repeatedly
# towards the row start, as far as points are observed. Without this, 3 px decaying within 10 columns gave 2.6 times the error there and
# twice the error elsewhere.
MAX_HALVINGS = 3


@dataclass(frozen=True, slots=True)
class DistortionSpline:
    """E(R) in px at scan address R: an ideal raster places R at R - E(R).

    Parameters are ordered row by row: coefficient (iy, ix) is ``iy * along_x.size + ix``.

    Attributes:
        along_x: spline over columns; its knots may be closer at the row start.
        along_y: spline over rows.
        carried: whether the drift advects the distortion, E(R - d) as in equations 6 and 9 of Sutton 2007 (gamma = 1); otherwise the
            distortion is fixed at the scan address, E(R) (gamma = 0).
    """

    along_x: UniformSpline | KnotSpline
    along_y: UniformSpline
    carried: bool = False

    @classmethod
    def covering(cls, width_px: int, height_px: int, knot_px: float, first_px: float | None = None) -> DistortionSpline:
        """A spline over a frame with knots at most `knot_px` apart, closer between the row start and the first observed column."""
        nx, ny = math.ceil((width_px - 1) / knot_px), math.ceil((height_px - 1) / knot_px)
        spacing_px = (width_px - 1) / nx
        halvings = sum(spacing_px * 0.5**count >= first_px for count in range(1, MAX_HALVINGS + 1)) if first_px is not None else 0
        along_y = UniformSpline(0.0, (height_px - 1) / ny, ny, DEGREE)
        if not halvings:
            return cls(UniformSpline(0.0, spacing_px, nx, DEGREE), along_y)
        return cls(towards_start(width_px - 1.0, nx, halvings, DEGREE), along_y)

    @property
    def name(self) -> str:
        """``distortion``."""
        return "distortion"

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 2 * self.along_x.size * self.along_y.size

    @property
    def needs_ideal(self) -> bool:
        """False: it depends on the scan address only."""
        return False

    def columns(self, observation: FrameObservation) -> tuple[TensorColumns, ...]:
        """Tensor-product basis rows at the scan addresses."""
        x_px, y_px = observation.x_px, observation.y_px
        if self.carried:
            if observation.drift_px is None:
                raise ValueError("a distortion that the drift advects needs the drift at the points")
            x_px, y_px = x_px - observation.drift_px[:, 0], y_px - observation.drift_px[:, 1]
        index_x, value_x = self.along_x.local(x_px)
        index_y, value_y = self.along_y.local(y_px)
        return (TensorColumns(Axis.EACH, index_x, value_x, index_y, value_y, (self.along_y.size, self.along_x.size)),)

    def field(self, parameters: NDArray[np.float64], x_px: ArrayLike, y_px: ArrayLike) -> NDArray[np.float64]:
        """(n, 2) E at scan addresses."""
        coefficients = np.ascontiguousarray(parameters.reshape(self.along_y.size, self.along_x.size, 2), dtype=np.float64)
        return evaluate_surface(*self.along_y.local(y_px), *self.along_x.local(x_px), coefficients)

    def roughness(self, order: int = 2) -> NDArray[np.float64]:
        """(size / 2, size / 2) sum of all squared differences of an order of the coefficients (order 2: a thin plate's bending).

        Nothing below the order is penalised.
        """
        return _roughness(self.along_x, self.along_y, order)

    def affine_rows(self, grid: Grid) -> NDArray[np.float64]:
        """(3, size / 2) rows giving one component's best affine map over a grid: mean, change over half the extent in x, in y."""
        x, y = grid.x_px, grid.y_px
        to_x, to_y = _mean_and_slope(x), _mean_and_slope(y)
        index_x, value_x = self.along_x.local(x)
        index_y, value_y = self.along_y.local(y)
        rows_x, rows_y = np.zeros((grid.nx, self.along_x.size)), np.zeros((grid.ny, self.along_y.size))
        np.put_along_axis(rows_x, index_x, value_x, axis=1)
        np.put_along_axis(rows_y, index_y, value_y, axis=1)
        mean_x, slope_x = to_x @ rows_x
        mean_y, slope_y = to_y @ rows_y
        return np.stack((np.kron(mean_y, mean_x), np.kron(mean_y, slope_x), np.kron(slope_y, mean_x)))


@lru_cache(maxsize=16)
def _roughness(x: UniformSpline | KnotSpline, y: UniformSpline, order: int) -> NDArray[np.float64]:
    table = np.sum([math.comb(order, i) * np.kron(y.roughness(i), x.roughness(order - i)) for i in range(order + 1)], axis=0)
    table.setflags(write=False)
    return table


def _mean_and_slope(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, n) weights that give the mean of samples and their fitted change over half the extent."""
    centred = position - position.mean()
    half = max(float(np.max(np.abs(centred))), 1.0)
    spread = float(centred @ centred) or 1.0
    return np.stack((np.full(len(position), 1.0 / len(position)), centred * half / spread))
