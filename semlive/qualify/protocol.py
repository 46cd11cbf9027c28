"""Recommended protocol: waiting time, dwell, gauge and shifts of the calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping

from semlive.dic import CorrelationChoice
from semlive.qualify.values import Conditions, Figure, Protocol

GOOD_NOISE_PX = 0.02
"""Displacement noise in the paper of the method; less is determined by other errors."""
MAX_DWELL_FACTOR, MIN_DWELL_FACTOR = 4.0, 0.5
MAX_DRIFT_IN_FRAME_PX = 3.0
"""Largest drift during a frame for which a longer dwell is recommended: beyond, the estimate of its curvature dominates."""
SHIFT_SHARE = 0.03
"""Largest shift as a share of the shorter edge, as in the calibration of the paper (32 of 1024 px)."""
STEPS = ((0, 0), (2, 0), (-2, 0), (1, 0), (0, 2), (0, -2), (0, 1), (-1, -1), (0, 0))
"""Cross of shifts, in halves of the largest: both signs of both axes, and the first place again."""
RATE_MARGIN = 1.3
MAX_HOLD_S = 30.0
GAUGE_PX = 83


def recommend_protocol(conditions: Conditions, figures: Mapping[str, Figure], choice: CorrelationChoice) -> Protocol:
    """Protocol for a microscope from its figures.

    Args:
        conditions: of the frames.
        figures: measured figures by name.
        choice: recommended correlation.
    """
    noise = figures.get(f"noise_{choice.subset_px}")
    noise_px = choice.sigma_u_px if noise is None else noise.value
    drift_px = figures["drift_in_frame"].value
    required = min(max((noise_px / GOOD_NOISE_PX) ** 2, MIN_DWELL_FACTOR), MAX_DWELL_FACTOR)
    allowed = max(MAX_DRIFT_IN_FRAME_PX / max(drift_px, 1e-9), MIN_DWELL_FACTOR)
    factor = max(math.ceil(2.0 * min(required, allowed)) / 2.0, MIN_DWELL_FACTOR)
    largest = max(round(SHIFT_SHARE * min(conditions.width_px, conditions.height_px)), 4)
    shifts = tuple((0.5 * largest * x, 0.5 * largest * y) for x, y in STEPS)
    wait, final = figures.get("waiting_time"), figures.get("drift_rate_final")
    wait_s = 0.0 if wait is None else wait.value
    rate = None if final is None else RATE_MARGIN * max(final.high, figures["drift_rate"].value * 0.1)
    hold_s = min(MAX_HOLD_S, conditions.frame_s)
    points = max(2 * round((GAUGE_PX - choice.subset_px) / (2 * choice.step_px)), 2) + 1
    minutes = (wait_s + len(shifts) * (2.0 * factor * conditions.frame_s + hold_s)) / 60.0
    return Protocol(wait_s, rate, factor, choice.subset_px, choice.step_px, points, shifts, hold_s, minutes)
