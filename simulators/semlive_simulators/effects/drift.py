"""Drift of the beam: during the warm-up of the column, and slowly after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict


@dataclass(frozen=True, slots=True)
class AxisDrift:
    """Drift of one axis: an exponential approach plus a slow polynomial. Jumps and random walks are separate effects.

    Attributes:
        warmup_px: total drift of the warm-up.
        warmup_s: time constant of the warm-up.
        linear_px_s: constant rate.
        quadratic_px_s2: coefficient of t squared.
        cubic_px_s3: coefficient of t cubed.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    warmup_px: float
    warmup_s: float
    linear_px_s: float
    quadratic_px_s2: float
    cubic_px_s3: float = 0.0

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Drift in px at seconds since the run began."""
        slow = (self.linear_px_s + (self.quadratic_px_s2 + self.cubic_px_s3 * time_s) * time_s) * time_s
        return -self.warmup_px * np.expm1(-time_s / self.warmup_s) + slow


@dataclass(frozen=True, slots=True)
class Drift:
    """Drift of the image in both axes; positive moves the image to the right and down."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    x: AxisDrift
    y: AxisDrift

    def at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Drift in px at seconds since the run began, (..., 2) for times (...)."""
        times = np.asarray(time_s, dtype=np.float64)
        return np.stack([self.x.at(times), self.y.at(times)], axis=-1)
