"""Raster time: scan time of an address (Sutton 2007, equations 1-4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from semlive.data.drift import FrameTime
from semlive.data.scan import ScanTiming
from semlive.model.effect import FrameObservation

# Drift is smooth over one scan, so the mean over many visits is taken over groups of visits; five groups of 16 visits
# leave 1/25 of the curvature term of one group, below 1e-4 px for any drift that five knots per frame can follow.
MAX_VISITS = 5


def visit_offsets_s(timing: ScanTiming) -> NDArray[np.float64]:
    """(visits,) offsets of the visits to one pixel from their mean; (0,) when the frame is a single scan."""
    scans = timing.integrations.value
    at = np.asarray((np.arange(scans) - 0.5 * (scans - 1)) * timing.frame_time_s.value, dtype=np.float64)
    return np.array([float(group.mean()) for group in np.array_split(at, MAX_VISITS)], dtype=np.float64) if scans > MAX_VISITS else at


def sighting(when: FrameTime, x_px: ArrayLike, y_px: ArrayLike, ideal_px: NDArray[np.float64] | None = None) -> FrameObservation:
    """Observation of points at scan addresses (x, y), of any shape, in a frame."""
    x, y = np.asarray(x_px, dtype=np.float64).ravel(), np.asarray(y_px, dtype=np.float64).ravel()
    mean_time_s = when.start_s + when.timing.time_in_frame_s(x, y)
    visits = visit_offsets_s(when.timing)[:, None] + mean_time_s
    return FrameObservation(when.frame, when.frame // 2, x, y, visits, ideal_px)
