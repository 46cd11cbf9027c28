"""What not knowing exactly when scans began does to strain, where the drift is known from one pair after another.

Drift is known from how far the field of view went from one frame of a pair to the other, over the time between their starts. Wrong
starts make the drift wrong by the same fraction, and with it the strain that drift makes of a scan written row by row.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from semlive.data.drift import FrameTime
from semlive.data.strain import Tensor2


def start_time_strain(times: tuple[FrameTime, FrameTime], moved_px: ArrayLike) -> Tensor2:
    """Standard uncertainty of a mean strain from the uncertain starts of a pair's scans.

    A point at (x, y) is written ``x t_D + y t_R`` after the start (Sutton 2007, equation 3), so a drift of rate r strains by r t_D
    along x and r t_R along y; r is known to the fraction to which the time between the starts is.

    Args:
        times: of the pair's frames.
        moved_px: (2,) how far the field of view went in between, mean over the grid.
    """
    first, second = times
    apart_s = second.start_s - first.start_s
    if not apart_s > 0:
        return Tensor2(0.0, 0.0, 0.0)
    x, y = np.abs(np.asarray(moved_px, dtype=np.float64)) / apart_s * math.hypot(first.start_sigma_s, second.start_sigma_s) / apart_s
    dwell_s, row_s = second.timing.dwell_time_s.value, second.timing.row_time_s.value
    return Tensor2(float(x * dwell_s), float(y * row_s), 0.5 * float(np.hypot(x * row_s, y * dwell_s)))
