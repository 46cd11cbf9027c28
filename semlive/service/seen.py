"""What analysis found out that the engine decides on."""

from __future__ import annotations

import math

from semlive.engine import CalibrationJudged, DriftForeseen, FieldSeen
from semlive.formats.messages import DicMessage, DriftMessage


def field_seen(message: DicMessage, time_ns: int) -> FieldSeen | None:
    """Where the field of view went since frame 0, if most of it was found again; None if the map does not tell."""
    mean_u, mean_v = message.mean_u_px, message.mean_v_px
    if message.reference != 0 or mean_u is None or mean_v is None or 2 * message.converged <= message.points:
        return None
    return FieldSeen(time_ns, message.current // 2, (mean_u, mean_v))


def drift_foreseen(message: DriftMessage, zero_ns: int, time_ns: int) -> DriftForeseen:
    """How fast the drift is expected to be.

    Args:
        message: an estimate of the drift.
        zero_ns: experiment time of the start of frame 0, from which the estimate counts.
        time_ns: experiment time now.
    """
    newest, forecast = max(message.frame) // 2, message.forecast
    if forecast is None:
        return DriftForeseen(time_ns, newest, ())
    scans = []
    for begin_s, (x, y), (sigma_x, sigma_y) in zip(forecast.time_s, forecast.rate_px_s, forecast.sigma_px_s, strict=True):
        rate = math.hypot(x, y)
        # Along the drift's own direction, where there is one.
        sigma = math.hypot(x * sigma_x, y * sigma_y) / rate if rate > 0 else max(sigma_x, sigma_y)
        scans.append((zero_ns + round(begin_s * 1e9), rate, sigma))
    return DriftForeseen(time_ns, newest, tuple(scans))


def calibration_judged(message: DriftMessage, time_ns: int) -> CalibrationJudged | None:
    """What the calibration is worth; None if the message does not tell."""
    told = message.calibration
    return None if told is None else CalibrationJudged(time_ns, max(message.frame) // 2, told.refused)
