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
    """Standard uncertainty of a mean strain from the uncertain start times of the scans of a pair.

    A point at (x, y) is written ``x t_D + y t_R`` after the start (Sutton 2007, equation 3), so a drift of rate r causes a strain of r t_D
    along x and r t_R along y. The relative uncertainty of r is that of the time between the starts.

    Args:
        times: of the pair's frames.
        moved_px: (2,) displacement of the field of view between the starts, mean over the grid, px.
    """
    first, second = times
    interval_s = second.start_s - first.start_s
    if not interval_s > 0:
        return Tensor2(0.0, 0.0, 0.0)
    x, y = np.abs(np.asarray(moved_px, dtype=np.float64)) / interval_s * math.hypot(first.start_sigma_s, second.start_sigma_s) / interval_s
    dwell_s, row_s = second.timing.dwell_time_s.value, second.timing.row_time_s.value
    return Tensor2(float(x * dwell_s), float(y * row_s), 0.5 * float(np.hypot(x * row_s, y * dwell_s)))
