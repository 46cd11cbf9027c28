"""Odd rows run from right to left, and the beam lags behind in both directions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification
from semlive_simulators.microscope.scan import Scan, Timing


@dataclass(frozen=True, slots=True)
class BidirectionalScan(Effect):
    """t = (W - 1 - x) t_D + y t_R in odd rows; u = (-1)^y lag / 2.

    Attributes:
        lag_px: how far rows of one direction lie beside those of the other.
    """

    name: ClassVar[str] = "bidirectional_scan"

    lag_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> BidirectionalScan:
        """1 px."""
        return cls(pick_by_magnification(magnification, 1.0, 1.0))

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Odd rows are reversed."""
        return replace(timing, reversed_rows=np.arange(scan.height_px) % 2 == 1)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Alternates from row to row."""
        return np.where(at.y_px % 2 == 1, -0.5, 0.5) * self.lag_px, np.zeros((1, 1))
