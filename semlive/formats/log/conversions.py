"""Conversion of values to messages and back. Each pair of functions is exact: the round trip returns an equal value."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from semlive.data.clock import Clock
from semlive.data.drift import CalibrationQuality, DistortionField, DriftEstimate, DriftForecast, PairMotion
from semlive.data.frame import FrameInfo
from semlive.data.loading import FrameLoad, LoadSample, StageSample
from semlive.data.pair import PairDecision
from semlive.data.scan import ScanTiming
from semlive.data.scan_report import ScanReading, ScanReport
from semlive.data.strain import ElasticConstants, StrainGageComparison, StrainSummary
from semlive.formats.log.messages import (
    ClockMessage,
    DistortionMessage,
    DriftForecastMessage,
    DriftMessage,
    ElasticMessage,
    LoadSampleMessage,
    MotionMessage,
    PairMessage,
    Point,
    ScanMessage,
    ScanReadingMessage,
    StageSampleMessage,
    StrainMessage,
    TriggerMessage,
)

T = TypeVar("T", bound=np.generic)


def clock_message(clock: Clock, reason: str) -> ClockMessage:
    """Convert a clock, with the reason for its validity."""
    return ClockMessage(utc0_ns=clock.utc0_ns, mono0_ns=clock.mono0_ns, rate=clock.rate, revision=clock.revision, reason=reason)


def clock(message: ClockMessage) -> Clock:
    """Return the clock of a message."""
    return Clock(message.utc0_ns, message.mono0_ns, message.rate, message.revision)


def load_sample_message(sample: LoadSample) -> LoadSampleMessage:
    """Convert a reading of the load frame."""
    return LoadSampleMessage.model_validate(sample, from_attributes=True)


def load_sample(message: LoadSampleMessage) -> LoadSample:
    """Return the reading of a message."""
    return LoadSample(**{name: getattr(message, name) for name in LoadSampleMessage.model_fields if name != "boot_id"})


def stage_sample_message(sample: StageSample) -> StageSampleMessage:
    """Convert a reading of the stage."""
    return StageSampleMessage.model_validate(sample, from_attributes=True)


def stage_sample(message: StageSampleMessage) -> StageSample:
    """Return the reading of a message."""
    return StageSample(**{name: getattr(message, name) for name in StageSampleMessage.model_fields if name != "boot_id"})


def trigger_message(report: ScanReport) -> TriggerMessage:
    """Convert the settings of a triggered scan."""
    return TriggerMessage(
        time_ns=report.end_time_ns,
        file=report.file,
        before=_scan_reading_message(report.before),
        after=_scan_reading_message(report.after),
        measured_row_time_s=report.measured_row_time_s,
    )


def _scan_reading_message(reading: ScanReading) -> ScanReadingMessage:
    values = {name: getattr(reading, name) for name in ScanReadingMessage.model_fields}
    return ScanReadingMessage(**{**values, "others": dict(reading.others)})


def _scan_reading(message: ScanReadingMessage) -> ScanReading:
    values = {name: getattr(message, name) for name in ScanReadingMessage.model_fields}
    return ScanReading(**{**values, "others": tuple(message.others.items())})


def trigger_report(message: TriggerMessage) -> ScanReport:
    """Return the settings of a triggered scan."""
    before, after = (_scan_reading(reading) for reading in (message.before, message.after))
    return ScanReport(before, after, message.file, message.time_ns, message.measured_row_time_s)


def scan_message(info: FrameInfo, frame: int | None = None, load: FrameLoad | None = None) -> ScanMessage:
    """Convert the metadata of a frame; `frame` is its number in the analysis, None without one."""
    return ScanMessage(
        frame=frame,
        export=info.export,
        name=info.name,
        vendor=info.vendor,
        width_px=info.width_px,
        height_px=info.height_px,
        databar_rows=info.databar_rows,
        dwell_time_s=info.timing.dwell_time_s,
        row_time_s=info.timing.row_time_s,
        frame_time_s=info.timing.frame_time_s,
        integrations=info.timing.integrations,
        start_time_ns=info.start_time_ns,
        start_sigma_s=info.start_sigma_s,
        end_time_ns=info.end_time_ns,
        pixel_size_m=info.pixel_size_m,
        load_before_n=None if load is None else load.before_n,
        load_after_n=None if load is None else load.after_n,
        load_mean_n=None if load is None else load.mean_n,
        load_sd_n=None if load is None else load.sd_n,
        gage_strain_mean=None if load is None else load.gage_strain,
        line_integrations=info.timing.line_integrations,
        column=info.column,
        start_anchor=info.start_anchor,
        embedded_time_ns=info.embedded_time_ns,
        notes=info.notes,
        geometry=info.geometry,
        clock=info.timing.clock,
    )


def frame_info(message: ScanMessage) -> FrameInfo:
    """Return the metadata of a frame from a message."""
    return FrameInfo(
        export=message.export,
        name=message.name,
        vendor=message.vendor,
        width_px=message.width_px,
        height_px=message.height_px,
        databar_rows=message.databar_rows,
        timing=ScanTiming(
            message.dwell_time_s,
            message.row_time_s,
            message.frame_time_s,
            message.integrations,
            message.line_integrations,
            message.clock,
        ),
        start_time_ns=message.start_time_ns,
        start_sigma_s=message.start_sigma_s,
        pixel_size_m=message.pixel_size_m,
        column=message.column,
        start_anchor=message.start_anchor,
        embedded_time_ns=message.embedded_time_ns,
        notes=message.notes,
        geometry=message.geometry,
    )


def pair_message(decision: PairDecision) -> PairMessage:
    """Convert the decision of the engine about a pair."""
    return PairMessage(pair=decision.pair, step=decision.step, first=decision.first, second=decision.second, loads=decision.loads)


def pair_decision(message: PairMessage) -> PairDecision:
    """Return the decision of the engine from a message."""
    return PairDecision(message.pair, message.step, message.first, message.second, message.loads)


def drift_message(drift: DriftEstimate, calibration: CalibrationQuality | None = None, pairs: int | None = None) -> DriftMessage:
    """Convert one revision of drift, with the number of its pairs and the quality of the calibration."""
    drift_px, sigma_px, rate_px_s = (_newest(column) for column in (drift.drift_px, drift.sigma_px, drift.rate_px_s))
    return DriftMessage(
        revision=drift.revision,
        pairs=pairs,
        newest_pair=int(drift.frame.max()) // 2 if len(drift.frame) else None,
        time_s=drift.time_s.tolist(),
        frame=drift.frame.tolist(),
        drift_px=drift.drift_px.tolist(),
        sigma_px=drift.sigma_px.tolist(),
        rate_px_s=drift.rate_px_s.tolist(),
        forecast=None if drift.forecast is None else _forecast_message(drift.forecast),
        x_px=drift_px[0],
        y_px=drift_px[1],
        sigma_x_px=sigma_px[0],
        sigma_y_px=sigma_px[1],
        rate_x_px_s=rate_px_s[0],
        rate_y_px_s=rate_px_s[1],
        calibration=calibration,
    )


def _newest(column: NDArray[np.float64]) -> tuple[float | None, float | None]:
    return _point(column[-1]) if len(column) else (None, None)


def _forecast_message(forecast: DriftForecast) -> DriftForecastMessage:
    return DriftForecastMessage(
        time_s=forecast.time_s.tolist(),
        duration_s=forecast.duration_s,
        rate_px_s=forecast.rate_px_s.tolist(),
        sigma_px_s=forecast.sigma_px_s.tolist(),
    )


def drift_estimate(message: DriftMessage) -> DriftEstimate:
    """Return the drift of a message."""
    return DriftEstimate(
        time_s=_array(message.time_s, np.float64, (-1,)),
        frame=_array(message.frame, np.int64, (-1,)),
        drift_px=_array(message.drift_px, np.float64, (-1, 2)),
        sigma_px=_array(message.sigma_px, np.float64, (-1, 2)),
        rate_px_s=_array(message.rate_px_s, np.float64, (-1, 2)),
        revision=message.revision,
        forecast=None if message.forecast is None else _forecast(message.forecast),
    )


def _forecast(message: DriftForecastMessage) -> DriftForecast:
    return DriftForecast(
        time_s=_array(message.time_s, np.float64, (-1,)),
        duration_s=message.duration_s,
        rate_px_s=_array(message.rate_px_s, np.float64, (-1, 2)),
        sigma_px_s=_array(message.sigma_px_s, np.float64, (-1, 2)),
    )


def distortion_message(field: DistortionField, revision: int) -> DistortionMessage:
    """Convert one revision of distortion."""
    return DistortionMessage(
        revision=revision,
        grid=field.grid,
        ex_px=field.ex_px.tolist(),
        ey_px=field.ey_px.tolist(),
        sigma_px=field.sigma_px.tolist(),
        valid=field.valid.tolist(),
    )


def distortion_field(message: DistortionMessage) -> DistortionField:
    """Return the distortion of a message."""
    return DistortionField(
        grid=message.grid,
        ex_px=_array(message.ex_px, np.float64, message.grid.shape),
        ey_px=_array(message.ey_px, np.float64, message.grid.shape),
        sigma_px=_array(message.sigma_px, np.float64, message.grid.shape),
        valid=_array(message.valid, np.bool_, message.grid.shape),
    )


def motion_message(motion: PairMotion, revision: int) -> MotionMessage:
    """Convert one revision of the motion of a pair."""
    (dudx, dudy), (dvdx, dvdy) = motion.gradient.tolist()
    (sudx, sudy), (svdx, svdy) = motion.gradient_sigma.tolist()
    return MotionMessage(
        revision=revision,
        pair=motion.pair,
        shift_px=_point(motion.shift_px),
        shift_sigma_px=_point(motion.shift_sigma_px),
        gradient=((dudx, dudy), (dvdx, dvdy)),
        gradient_sigma=((sudx, sudy), (svdx, svdy)),
    )


def motion(message: MotionMessage) -> PairMotion:
    """Return the motion of a message."""
    return PairMotion(
        pair=message.pair,
        shift_px=_array(message.shift_px, np.float64, (2,)),
        shift_sigma_px=_array(message.shift_sigma_px, np.float64, (2,)),
        gradient=_array(message.gradient, np.float64, (2, 2)),
        gradient_sigma=_array(message.gradient_sigma, np.float64, (2, 2)),
    )


def strain_message(summary: StrainSummary, revision: int) -> StrainMessage:
    """Convert the strain of one frame."""
    return StrainMessage(
        revision=revision,
        frame=summary.frame,
        mean=summary.mean,
        mean_sigma=summary.mean_sigma,
        sd=summary.sd,
        vsg_px=summary.vsg_px,
        gauge_sigma=summary.gauge_sigma,
        systematic_sigma=summary.systematic_sigma,
    )


def strain_summary(message: StrainMessage) -> StrainSummary:
    """Return the strain of a message."""
    return StrainSummary(
        message.frame, message.mean, message.mean_sigma, message.sd, message.vsg_px, message.gauge_sigma, message.systematic_sigma
    )


def elastic_message(
    elastic: ElasticConstants | None, revision: int, gage: StrainGageComparison | None = None, pairs: int | None = None
) -> ElasticMessage:
    """Convert elastic constants, with the number of their pairs."""
    modulus, ratio = (None, None) if elastic is None else (elastic.youngs_modulus_gpa, elastic.poissons_ratio)
    return ElasticMessage(revision=revision, pairs=pairs, youngs_modulus_gpa=modulus, poissons_ratio=ratio, gage=gage)


def elastic_constants(message: ElasticMessage) -> ElasticConstants | None:
    """Return the elastic constants of a message."""
    if message.youngs_modulus_gpa is None or message.poissons_ratio is None:
        return None
    return ElasticConstants(message.youngs_modulus_gpa, message.poissons_ratio)


def _point(values: NDArray[np.float64]) -> Point:
    x, y = values.tolist()
    return x, y


def _array(values: object, dtype: type[T], shape: tuple[int, ...]) -> NDArray[T]:
    array = np.array(values, dtype=dtype).reshape(shape)
    array.setflags(write=False)
    return array
