"""Frame 0, the reference of displacement."""

from __future__ import annotations

import numpy as np

from semlive.data.displacement import Displacement
from semlive.data.grid import Grid


def zero_displacement(grid: Grid) -> Displacement:
    """Displacement of frame 0 from itself: zero everywhere, without uncertainty."""
    zero, valid = np.zeros(grid.shape), np.ones(grid.shape, dtype=np.bool_)
    zero.setflags(write=False)
    valid.setflags(write=False)
    return Displacement(0, grid, zero, zero, zero, zero, valid)
