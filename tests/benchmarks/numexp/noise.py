"""Noise of the correlation: each frame has its own, attached to the place in the frame; a map shows the difference of two."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, map_coordinates

LATTICE_PX = 5
MARGIN_PX = 100
# A 43 px subset covers 8.6 points of the lattice: N points are worth N (5 / 43)^2 independent ones, 243 of 18,000.
SUBSET_WEIGHTS = np.array([0.8, *[1.0] * 7, 0.8])
GAUSSIAN_WEIGHTS = np.exp(-0.5 * (np.arange(-6, 7) * LATTICE_PX / 8.6) ** 2)


class NoiseKind(Enum):
    """How noise is shared between points."""

    NONE = "none"
    WHITE = "white"
    CORRELATED = "correlated"
    """Means over 43 px subsets that overlap on the 5 px grid."""
    GAUSSIAN = "gaussian"
    """Gaussian weights with a standard deviation of a fifth of the subset."""


@dataclass
class FrameNoise:
    """Noise of all frames of an experiment.

    Attributes:
        kind: how it is shared between points.
        map_sd_px: standard deviation of a map's component; a frame has 1 / sqrt(2) of it.
        seed: decides the noise.
        width_px: of the frame.
        height_px: of the frame.
    """

    kind: NoiseKind
    map_sd_px: float
    seed: int
    width_px: int
    height_px: int
    fields: dict[int, NDArray[np.float64]] = field(init=False, default_factory=dict)

    def at(self, frame: int, address_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) noise of a frame at scan addresses (n, 2)."""
        if self.kind is NoiseKind.NONE:
            return np.zeros_like(address_px)
        if frame not in self.fields:
            self.fields[frame] = self._drawn(frame)
        where = (address_px.T[::-1] + MARGIN_PX) / LATTICE_PX
        order = 0 if self.kind is NoiseKind.WHITE else 3
        return np.stack([map_coordinates(item, where, order=order, mode="nearest") for item in self.fields[frame]], axis=-1)

    def _drawn(self, frame: int) -> NDArray[np.float64]:
        rng = np.random.default_rng((self.seed, 71, frame))
        shape = (2, (self.height_px + 2 * MARGIN_PX) // LATTICE_PX + 1, (self.width_px + 2 * MARGIN_PX) // LATTICE_PX + 1)
        white = rng.normal(size=shape)
        if self.kind is not NoiseKind.WHITE:
            weights = GAUSSIAN_WEIGHTS if self.kind is NoiseKind.GAUSSIAN else SUBSET_WEIGHTS
            weights = weights / np.sqrt(np.sum(weights**2))
            white = correlate1d(correlate1d(white, weights, axis=1, mode="wrap"), weights, axis=2, mode="wrap")
        return white * (self.map_sd_px / np.sqrt(2.0))
