"""Random horizontal offset of each row: noise of the scan generator, stray fields, acoustic noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Effect, Magnification, PixelVisits, Plane, pick_by_magnification
from semlive_simulators.kernels.exposure import gaussians


@dataclass(frozen=True, slots=True)
class RowJitter(Effect):
    """u = a(frame, visit, row), white and normal.

    Attributes:
        sd_px: standard deviation.
        seed: seed of the jitter.
    """

    name: ClassVar[str] = "row_jitter"

    sd_px: float
    seed: int = 1

    @classmethod
    def defaults(cls, magnification: Magnification) -> RowJitter:
        """0.03 or 0.2 px."""
        return cls(pick_by_magnification(magnification, 0.03, 0.2))

    def offset_px(self, at: PixelVisits) -> Plane:
        """One offset in x per row."""
        rows = at.y_px.shape[0]
        stream = 1_000_003 * at.frame + at.visit
        return self.sd_px * gaussians(self.seed, stream, int(at.y_px[0, 0]), rows)[:, None], np.zeros((1, 1))
