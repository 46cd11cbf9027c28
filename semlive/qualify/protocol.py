"""Recommended protocol: waiting time, dwell, gauge and shifts of the calibration.

Error model of a corrected displacement in a run of a given beam time T, as a variance: N^2 T / (T - w) (1 + c) + D^2 exp(-2 w / t). N is
the noise of a displacement in the dwell time that T permits without waiting, w the waiting time, c the share of the distortion, t the decay
time of the drift rate. N^2 is proportional to the number of pairs, and 1 + c differs by less than 5 % between calibrations of 3, 4 and 5
pairs in simulated runs (`tests/benchmarks/qualify_protocols.py`): few pairs with a long dwell time are best. D is the part of the decay
that the drift spline cannot follow. A drift that decays from 0.04 px/s within 300 s has next to none: waiting for 300 s of 2000 s increased
the error by 8 %, as much as the noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from semlive.data.settings import EstimateSettings
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
"""Cross of shifts of a qualification, in halves of the largest: both signs of both axes, and the first place again."""
RUN_STEPS = (STEPS[0], STEPS[1], STEPS[4])
"""Calibration of a run: the two shifts that the distortion needs. With the first place again, the dwell time that is left was 19 % shorter,
and the error of six simulated runs 8 to 13 % larger than that of the best protocol; a qualification shows whether the stage returns.
"""
LOADED_PAIRS = 3
"""Pairs under load that follow the calibration in the error model."""
DRIFT_KNOTS_PER_FRAME = EstimateSettings().drift_knots_per_frame
SPLINE_ERROR = 5.0 / 384.0
"""Largest error of a cubic spline, in fourth derivatives times the fourth power of the knot distance (Hall & Meyer 1976)."""
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
    shifts = tuple((0.5 * largest * x, 0.5 * largest * y) for x, y in RUN_STEPS)
    hold_s = min(MAX_HOLD_S, conditions.frame_s)
    scan_s = 2.0 * factor * conditions.frame_s
    wait_s, rate = _waiting(figures, noise_px / math.sqrt(factor), scan_s, len(shifts) + LOADED_PAIRS)
    points = max(2 * round((GAUGE_PX - choice.subset_px) / (2 * choice.step_px)), 2) + 1
    minutes = (wait_s + len(shifts) * (scan_s + hold_s)) / 60.0
    return Protocol(wait_s, rate, factor, choice.subset_px, choice.step_px, points, shifts, hold_s, minutes)


def _waiting(figures: Mapping[str, Figure], noise_px: float, scan_s: float, pairs: int) -> tuple[float, float | None]:
    """Waiting time after the first pair with the least error by the model, s, and the drift rate there, px/s; 0 and None if none pays.

    Args:
        figures: measured figures by name.
        noise_px: noise of a displacement at the recommended dwell time.
        scan_s: duration of the scans of a pair.
        pairs: number of pairs of the run.
    """
    decay, first, final = (figures.get(name) for name in ("drift_decay", "drift_rate_first", "drift_rate_final"))
    if decay is None or first is None or final is None or noise_px <= 0.0:
        return 0.0, None
    decaying_px_s = max(first.value - final.value, 0.0)
    unmodelled_px = SPLINE_ERROR * decaying_px_s * (0.5 * scan_s / DRIFT_KNOTS_PER_FRAME) ** 4 / decay.value**3
    gain = 2.0 * pairs * scan_s / decay.value * (unmodelled_px / noise_px) ** 2
    if gain <= 1.0:
        return 0.0, None
    wait_s = 0.5 * decay.value * math.log(gain)
    return wait_s, RATE_MARGIN * (final.high + decaying_px_s * math.exp(-wait_s / decay.value))
