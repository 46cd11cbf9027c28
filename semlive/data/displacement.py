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
        systematic_u_px: (ny, nx) standard uncertainty along x that the correction adds, its mean over the field left out; None where
            nobody asked, or the method does not say.
        systematic_v_px: along y.
    """

    frame: int
    grid: Grid
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    valid: NDArray[np.bool_]
    systematic_u_px: NDArray[np.float64] | None = None
    systematic_v_px: NDArray[np.float64] | None = None
