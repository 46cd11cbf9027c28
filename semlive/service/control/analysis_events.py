"""What analysis found out that the engine decides on."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict

from semlive.data.drift import CalibrationQuality
from semlive.engine import CalibrationAssessed, DriftForecastUpdated, FieldOfViewMeasured
from semlive.errors import BadLog
from semlive.formats.log.messages import DicMessage, DriftForecastMessage

_FRAMES = b'"frame":['


def field_of_view_event(message: DicMessage, time_ns: int) -> FieldOfViewMeasured | None:
    """Where the field of view went since frame 0, if most of it was found again; None if the map does not tell."""
    mean_u, mean_v = message.mean_u_px, message.mean_v_px
    if message.reference != 0 or mean_u is None or mean_v is None or 2 * message.converged <= message.points:
        return None
    return FieldOfViewMeasured(time_ns, message.current // 2, (mean_u, mean_v))


class DriftUpdate(BaseModel):
    """What of an estimate of the drift is decided on; the rest, drift and uncertainty over the whole run, is passed over.

    As Python objects that takes 8 kB a pair for a moment, whenever all frames are told anew, and Python gave it back to no one.

    Attributes:
        revision: of the estimate.
        pairs: how many it knows; None in logs that count them by the revision.
        newest_pair: that it knows.
        rate_x_px_s: at the newest frame.
        rate_y_px_s: likewise.
        forecast: of the drift.
        calibration: what it is worth.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, cache_strings="keys")

    revision: int
    pairs: int | None = None
    newest_pair: int = 0
    rate_x_px_s: float | None = None
    rate_y_px_s: float | None = None
    forecast: DriftForecastMessage | None = None
    calibration: CalibrationQuality | None = None


def parse_drift_update(payload: bytes) -> DriftUpdate:
    """Of a `/drift/estimate`.

    Raises:
        BadLog: it is none.
    """
    begin, end = payload.find(_FRAMES), payload.find(b"]", payload.find(_FRAMES))
    try:
        frames = np.fromstring(payload[begin + len(_FRAMES) : end], dtype=np.int64, sep=",")
        return DriftUpdate.model_validate_json(payload).model_copy(update={"newest_pair": int(frames.max()) // 2})
    except ValueError as exc:
        raise BadLog("/drift/estimate: cannot be read; read this log with the version of semlive that wrote it.") from exc


def drift_forecast_event(message: DriftUpdate, zero_ns: int, time_ns: int) -> DriftForecastUpdated:
    """How fast the drift is expected to be.

    Args:
        message: an estimate of the drift.
        zero_ns: experiment time of the start of frame 0, from which the estimate counts.
        time_ns: experiment time now.
    """
    newest, forecast = message.newest_pair, message.forecast
    if forecast is None:
        return DriftForecastUpdated(time_ns, newest, ())
    scans = []
    for begin_s, (x, y), (sigma_x, sigma_y) in zip(forecast.time_s, forecast.rate_px_s, forecast.sigma_px_s, strict=True):
        rate = math.hypot(x, y)
        # Along the drift's own direction, where there is one.
        sigma = math.hypot(x * sigma_x, y * sigma_y) / rate if rate > 0 else max(sigma_x, sigma_y)
        scans.append((zero_ns + round(begin_s * 1e9), rate, sigma))
    return DriftForecastUpdated(time_ns, newest, tuple(scans))


def calibration_event(message: DriftUpdate, time_ns: int) -> CalibrationAssessed | None:
    """What the calibration is worth; None if the message does not tell."""
    told = message.calibration
    return None if told is None else CalibrationAssessed(time_ns, message.newest_pair, told.refused)
