"""Outputs of the analysis during a run: written to the log, and passed to the engine as events.

Theory of operation
-------------------
A thread of the analysis process hands the outputs over in their order; `on_output` runs in the loop of control and never blocks. Only the
topics that control uses are decoded. A pair that cannot be analysed stops the run, because all maps refer to the first pair.
"""

from __future__ import annotations

import asyncio
import math

from semlive.engine import FINAL_STATES, Device, DeviceFault, FrameScanned, FrameUnreadable, HoldDriftMeasured
from semlive.engine.load_history import frame_load
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import (
    ClockOffsetMessage,
    DicMessage,
    ElasticMessage,
    FaultMessage,
    FileMessage,
    HoldDriftMessage,
    ScanMessage,
    from_json,
)
from semlive.ports import ClockSource
from semlive.service.analysis.messages import is_model_warning
from semlive.service.analysis.pipe import AnalysisOutput, AnalysisReady
from semlive.service.control.analysis_events import (
    DriftUpdate,
    calibration_event,
    drift_forecast_event,
    field_of_view_event,
    parse_drift_update,
)
from semlive.service.control.run_engine import RunEngine
from semlive.service.control.run_monitor import RunMonitor
from semlive.service.log.run_log import RunLog

_DECODED_TOPICS = ("/clock/offset", "/sem/scan", "/sem/file", "/dic/summary", "/drift/hold", "/elastic", "/fault", "/result")


class AnalysisReceiver:
    """Receives the outputs of the analysis.

    Args:
        engine: the engine of the run.
        monitor: warnings and newest results.
        journal: the log of the run.
        clock: experiment time.
    """

    def __init__(self, engine: RunEngine, monitor: RunMonitor, journal: RunLog, clock: ClockSource) -> None:
        self._engine, self._monitor, self._journal, self._clock = engine, monitor, journal, clock
        self.ready = asyncio.Event()
        """Set when the analysis is ready for the first pair."""

    def on_output(self, message: AnalysisOutput) -> None:
        """Log a message of the analysis and pass its events to the engine."""
        if isinstance(message, AnalysisReady):
            self._journal.output(message.line)
            self.ready.set()
            return
        payload = from_json(message.topic, message.payload) if message.topic in _DECODED_TOPICS else None
        if isinstance(payload, ScanMessage):
            info = values.frame_info(payload)
            self._journal.scan(info, frame_load(self._engine.state.devices.history, info.start_time_ns.value, info.end_time_ns))
            self._engine.handle(FrameScanned(self._clock.now_ns(), info))
            return
        self._journal.output(message)
        if isinstance(payload, FileMessage) and payload.export is not None:
            self._monitor.warn(payload.reason)
            self._engine.handle(FrameUnreadable(self._clock.now_ns(), payload.export, payload.reason))
        elif isinstance(payload, ClockOffsetMessage) and payload.advice:
            self._monitor.warn(payload.advice)
        elif isinstance(payload, DicMessage):
            self._handle_field_of_view(payload)
        elif message.topic == "/drift/estimate":
            self._handle_drift(parse_drift_update(message.payload))
        elif isinstance(payload, HoldDriftMessage):
            self._engine.handle(HoldDriftMeasured(self._clock.now_ns(), payload.begin_time_ns, math.hypot(*payload.rate_px_s)))
        elif isinstance(payload, ElasticMessage):
            self._monitor.elastic = payload
        elif isinstance(payload, FaultMessage):
            self._monitor.warn(payload.what)
            if not is_model_warning(payload):
                self._pair_unusable(payload.what)

    def _handle_drift(self, update: DriftUpdate) -> None:
        """Store the drift rate; pass drift forecast and assessment of the calibration to the engine."""
        self._monitor.pairs_analysed, reference = update.pairs or update.revision, self._engine.state.imaging.reference
        if update.rate_x_px_s is not None and update.rate_y_px_s is not None:
            self._monitor.drift_rate_px_s = update.rate_x_px_s, update.rate_y_px_s
        if reference is not None:
            now_ns = self._clock.now_ns()
            calibration = calibration_event(update, now_ns)
            for event in (drift_forecast_event(update, reference.start_time_ns.value, now_ns), *([calibration] if calibration else [])):
                self._engine.handle(event)

    def _handle_field_of_view(self, message: DicMessage) -> None:
        """Pass the displacement of the field of view since frame 0 to the engine, if most points converged."""
        measured = field_of_view_event(message, self._clock.now_ns())
        if measured is not None:
            self._engine.handle(measured)

    def _pair_unusable(self, reason: str) -> None:
        """Stop the run with a fault: all maps refer to the first pair, and the cause may affect the following pairs too."""
        message = f"{'a' if self._monitor.pairs_analysed else 'the first'} pair cannot be used: {reason}"
        if self._engine.state.state in FINAL_STATES:
            self._monitor.unusable_pairs += (message,)
        else:
            self._engine.handle(DeviceFault(self._clock.now_ns(), Device.SEM, message))
