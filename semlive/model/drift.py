"""Drift: one function of absolute scan time, common to all points of the field, as a cubic spline per component."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semlive.model.effect import Axis, Columns, FrameObservation
from semlive.model.splines import UniformSpline


@dataclass(frozen=True, slots=True)
class DriftSpline:
    """d(t) in px: the point at p appears at p + d(t), so drift towards +x moves features towards +x.

    Attributes:
        spline: spline over time, seconds after the start of frame 0.
    """

    spline: UniformSpline

    @property
    def name(self) -> str:
        """``drift``."""
        return "drift"

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 2 * self.spline.size

    @property
    def needs_ideal(self) -> bool:
        """False."""
        return False

    def columns(self, observation: FrameObservation) -> tuple[Columns, ...]:
        """Basis rows at the visit times; the mean over the visits where a frame integrates several scans."""
        visits = [self.spline.local(time_s) for time_s in observation.visit_time_s]
        index = np.concatenate([index for index, _ in visits], axis=1)
        value = np.concatenate([value for _, value in visits], axis=1) / len(visits)
        return (Columns(Axis.EACH, index, value),)

    def until(self, time_s: float) -> DriftSpline:
        """The same spline, lengthened to reach `time_s`."""
        return DriftSpline(self.spline.until(time_s))

    def rows(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """(n, size / 2) dense basis rows at times."""
        return _dense(*self.spline.local(time_s), self.spline.size)

    def rate_rows(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """(n, size / 2) dense rows of the basis' time derivative, 1/s."""
        return _dense(*self.spline.local_rate(time_s), self.spline.size)

    def roughness(self, order: int = 2) -> NDArray[np.float64]:
        """(size / 2, size / 2) sum of squared differences of an order of neighbouring coefficients."""
        return self.spline.roughness(order)


def _dense(index: NDArray[np.int64], value: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    rows = np.zeros((len(index), size))
    np.put_along_axis(rows, index, value, axis=1)
    return rows
