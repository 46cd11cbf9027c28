"""Displacement: disparity corrected for drift and distortion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Displacement of the specimen from frame 0 to a frame, on the reference grid.

    Attributes:
        frame: number of the frame.
        grid: the POI, in frame 0.
        u_px: (ny, nx) along x; zero where not valid.
        v_px: (ny, nx) along y; zero where not valid.
        sigma_u_px: (ny, nx) standard uncertainty along x.
        sigma_v_px: (ny, nx) standard uncertainty along y.
        valid: (ny, nx) True where it was measured.
    """

    frame: int
    grid: Grid
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    valid: NDArray[np.bool_]
