"""Displacement: disparity minus drift and distortion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction
from semlive.data.grid import Grid
from semlive.data.strain import Displacement


def displacement(dmap: DisparityMap, correction: Correction) -> Displacement:
    """Displacement of the specimen from frame 0 to the frame of the map; that of frame 0 is zero by definition."""
    if dmap.reference != 0 or dmap.current != correction.frame:
        raise ValueError(f"a correction of frame {correction.frame} does not belong to a map {dmap.reference} -> {dmap.current}")
    valid = dmap.valid if correction.valid is None else dmap.valid & correction.valid
    valid.setflags(write=False)
    return Displacement(
        dmap.current,
        dmap.grid,
        _read_only(np.where(valid, dmap.u_px - correction.u_px, 0.0)),
        _read_only(np.where(valid, dmap.v_px - correction.v_px, 0.0)),
        dmap.sigma_u_px,
        dmap.sigma_v_px,
        valid,
    )


def zero_displacement(grid: Grid) -> Displacement:
    """Displacement of frame 0 from itself: zero everywhere, without uncertainty."""
    zero, valid = np.zeros(grid.shape), np.ones(grid.shape, dtype=np.bool_)
    zero.setflags(write=False)
    valid.setflags(write=False)
    return Displacement(0, grid, zero, zero, zero, zero, valid)


def _read_only(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.setflags(write=False)
    return array
