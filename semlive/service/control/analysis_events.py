"""Results of the analysis as events of the engine."""

from __future__ import annotations

import math

from pydantic import BaseModel, ConfigDict

from semlive.data.drift import CalibrationQuality
from semlive.engine import CalibrationAssessed, DriftForecastUpdated, FieldOfViewMeasured
from semlive.errors import BadLog
from semlive.formats.log.messages import DicMessage, DriftForecastMessage


def field_of_view_event(message: DicMessage, time_ns: int) -> FieldOfViewMeasured | None:
    """Return the mean disparity since frame 0; None for another reference, or if at most half of the points converged."""
    mean_u, mean_v = message.mean_u_px, message.mean_v_px
    if message.reference != 0 or mean_u is None or mean_v is None or 2 * message.converged <= message.points:
        return None
    return FieldOfViewMeasured(time_ns, message.current // 2, (mean_u, mean_v))


class DriftUpdate(BaseModel):
    """Parts of a drift estimate that control uses. Drift and uncertainty over the whole run are not parsed.

    As Python objects they would need 8 kB per pair whenever all frames are reported again, which Python does not return to the system.

    Attributes:
        revision: revision of the estimate.
        pairs: number of pairs in the estimate; None in logs in which `revision` is that number.
        newest_pair: number of the newest pair in the estimate.
        rate_x_px_s: x component of the drift rate at the newest frame.
        rate_y_px_s: y component of the drift rate at the newest frame.
        forecast: forecast of the drift; None without one.
        calibration: quality of the calibration; None without an assessment.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, cache_strings="keys")

    revision: int
    pairs: int | None = None
    newest_pair: int = 0
    rate_x_px_s: float | None = None
    rate_y_px_s: float | None = None
    forecast: DriftForecastMessage | None = None
    calibration: CalibrationQuality | None = None


class _DriftFrames(BaseModel):
    """Frame of each row of a drift estimate."""

    model_config = ConfigDict(frozen=True, extra="ignore", cache_strings="keys")

    frame: tuple[int, ...]


def parse_drift_update(payload: bytes) -> DriftUpdate:
    """Parse the payload of a `/drift/estimate` message.

    Raises:
        BadLog: the payload is invalid.
    """
    try:
        update = DriftUpdate.model_validate_json(payload)
        if "newest_pair" in update.model_fields_set:
            return update
        # Logs of older versions hold the frames only.
        frames = _DriftFrames.model_validate_json(payload).frame
        return update.model_copy(update={"newest_pair": max(frames) // 2})
    except ValueError as exc:
        raise BadLog("/drift/estimate: cannot be read; read this log with the version of semlive that wrote it.") from exc


def drift_forecast_event(message: DriftUpdate, reference_ns: int, time_ns: int) -> DriftForecastUpdated:
    """Return the drift forecast as an event.

    Args:
        message: an estimate of the drift.
        reference_ns: experiment time of the start of frame 0, the time origin of the estimate.
        time_ns: experiment time now.
    """
    newest, forecast = message.newest_pair, message.forecast
    if forecast is None:
        return DriftForecastUpdated(time_ns, newest, ())
    scans = []
    for begin_s, (x, y), (sigma_x, sigma_y) in zip(forecast.time_s, forecast.rate_px_s, forecast.sigma_px_s, strict=True):
        rate = math.hypot(x, y)
        # Along the direction of the drift if its rate is not zero.
        sigma = math.hypot(x * sigma_x, y * sigma_y) / rate if rate > 0 else max(sigma_x, sigma_y)
        scans.append((reference_ns + round(begin_s * 1e9), rate, sigma))
    return DriftForecastUpdated(time_ns, newest, tuple(scans))


def calibration_event(message: DriftUpdate, time_ns: int) -> CalibrationAssessed | None:
    """Return the assessment of the calibration as an event; None if the message has none."""
    calibration = message.calibration
    return None if calibration is None else CalibrationAssessed(time_ns, message.newest_pair, calibration.refused)
