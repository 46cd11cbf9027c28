"""Odd rows are scanned from right to left, with a lag of the beam in both directions."""

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
        lag_px: offset between rows of the two directions, px.
    """

    name: ClassVar[str] = "bidirectional_scan"

    lag_px: float

    @classmethod
    def defaults(cls, magnification: Magnification) -> BidirectionalScan:
        """1 px."""
        return cls(pick_by_magnification(magnification, 1.0, 1.0))

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """Reverse the odd rows."""
        return replace(timing, reversed_rows=np.arange(scan.height_px) % 2 == 1)

    def offset_px(self, at: PixelVisits) -> Plane:
        """An offset of alternating sign from row to row."""
        return np.where(at.y_px % 2 == 1, -0.5, 0.5) * self.lag_px, np.zeros((1, 1))
