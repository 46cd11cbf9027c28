"""Raster drift: slow changes of magnification and rotation of the raster, one spline each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semlive.model.effect import Axis, Columns, FrameObservation
from semlive.model.splines import UniformSpline


class RasterTerm(StrEnum):
    """Component of the raster change."""

    MAGNIFICATION = "magnification"
    """All distances from the image centre change by an equal fraction."""
    ROTATION = "raster_rotation"
    """Rotation of the image about its centre, positive from x towards y."""


@dataclass(frozen=True, slots=True)
class RasterChange:
    """a(t) (R - c) / r or a(t) J (R - c) / r, with a in px at the distance r from the image centre c.

    Attributes:
        term: which of the two.
        spline: over time in seconds after the start of frame 0.
        centre_px: (x, y) of the image centre.
        radius_px: r, half the image's width.
    """

    term: RasterTerm
    spline: UniformSpline
    centre_px: tuple[float, float]
    radius_px: float

    @property
    def name(self) -> str:
        """``magnification`` or ``raster_rotation``."""
        return self.term.value

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.spline.size

    @property
    def needs_ideal(self) -> bool:
        """False: it acts on the scan address."""
        return False

    def columns(self, observation: FrameObservation) -> tuple[Columns, ...]:
        """Basis rows at the mean visit time, times the lever."""
        index, by_x, by_y = _levers(self.spline, self.centre_px, self.radius_px, observation)
        along_x, along_y = (by_x, by_y) if self.term is RasterTerm.MAGNIFICATION else (-by_y, by_x)
        return Columns(Axis.X, index, along_x), Columns(Axis.Y, index, along_y)

    def rows(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """(n, size) dense rows that give the relative change (or the angle in rad) at times."""
        index, value = self.spline.local(time_s)
        rows = np.zeros((len(index), self.size))
        np.put_along_axis(rows, index, value / self.radius_px, axis=1)
        return rows

    def roughness(self, order: int = 2) -> NDArray[np.float64]:
        """(size, size) sum of squared differences of an order of neighbouring coefficients."""
        return self.spline.roughness(order)


@lru_cache(maxsize=2)  # two maps at a time
def _levers(
    spline: UniformSpline, centre_px: tuple[float, float], radius_px: float, observation: FrameObservation
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Indices, and basis values times the levers along x and y; cached, because rotation and magnification use equal values."""
    index, value = spline.local(observation.visit_time_s.mean(axis=0))
    x, y = (observation.x_px - centre_px[0]) / radius_px, (observation.y_px - centre_px[1]) / radius_px
    return index, value * x[:, None], value * y[:, None]
