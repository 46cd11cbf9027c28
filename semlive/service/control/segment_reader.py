"""Reader of the log of an interrupted run: the newest message of each kind, and all pairs.

Theory of operation
-------------------
`add` receives every message of the log in its order, in the calling thread. Only the newest message of each kind and the messages of the
pairs are held in memory, so a long log costs time but no memory. `result` checks that the run can be resumed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from semlive.data.clock import Clock
from semlive.data.loading import LoadSample, StageSample
from semlive.data.pair import PairDecision
from semlive.engine import CalibrationAssessed, DriftForecastUpdated, FieldOfViewMeasured, InterruptedRun, RampOrder, State
from semlive.errors import BadConfig, BadLog
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import (
    SEM_ORIGINAL,
    ClockMessage,
    CommandMessage,
    DicMessage,
    FaultMessage,
    FileMessage,
    LoadSampleMessage,
    PairMessage,
    ResultMessage,
    RunMessage,
    ScanMessage,
    StageSampleMessage,
    StateMessage,
    from_json,
)
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.messages import INPUT_TOPICS, fault_origin, is_output
from semlive.service.control.analysis_events import (
    DriftUpdate,
    calibration_event,
    drift_forecast_event,
    field_of_view_event,
    parse_drift_update,
)
from semlive.service.control.previous_segments import PreviousSegments
from semlive.service.log.alarms import TOPICS as ALARM_TOPICS
from semlive.service.log.alarms import Alarms, after_message

_DECODED_TOPICS = frozenset(
    {"/run", "/clock", "/state", "/command", "/pair", "/sem/file", "/sem/scan", "/dic/summary", "/fault", "/result"}
)


@dataclass(slots=True)
class _Counts:
    """Positions in the log and numbers of its messages."""

    inputs: int = 0
    outputs: int = 0
    exports: int = 0
    revision: int = 0
    pairs_analysed: int = 0
    last_log_time_ns: int = 0

    def add(self, message: LogMessage) -> None:
        """Count one message of the log."""
        self.inputs += message.topic in INPUT_TOPICS
        self.outputs += is_output(message)
        self.last_log_time_ns = max(self.last_log_time_ns, message.log_time_ns)

    def add_export(self, number: int) -> None:
        """Count an exported file."""
        self.exports = max(self.exports, number + 1)


@dataclass(slots=True)
class _Devices:
    """Newest readings of the devices, as bytes, and the last order."""

    ordered: RampOrder | None = None
    load: bytes | None = None
    stage: bytes | None = None
    origin_um: tuple[float, float] | None = None

    def add_stage_sample(self, payload: bytes) -> None:
        """Store a stage sample; the first one is the origin of the stage."""
        self.stage = payload
        if self.origin_um is None:
            first_sample = StageSampleMessage.model_validate_json(payload)
            self.origin_um = (first_sample.x_um, first_sample.y_um)


@dataclass(slots=True)
class SegmentReader:
    """Accumulator of the log messages: the newest message of each kind, and all pairs."""

    run: RunMessage | None = None
    boot_id: str = ""
    clock: Clock | None = None
    state: str = State.IDLE
    pairs: dict[int, PairDecision] = field(default_factory=dict)
    originals: set[int] = field(default_factory=set)
    field_of_view: FieldOfViewMeasured | None = None
    start_sigma_s: float | None = None
    first_unusable: str | None = None
    concluded: bool = False
    drift_forecast: DriftForecastUpdated | None = None
    calibration_assessment: CalibrationAssessed | None = None
    alarms: Alarms = field(default_factory=Alarms)
    counts: _Counts = field(default_factory=_Counts)
    devices: _Devices = field(default_factory=_Devices)

    def add(self, message: LogMessage) -> None:
        """Add one message of the log."""
        self.counts.add(message)
        if message.topic in ALARM_TOPICS:
            self.alarms = after_message(self.alarms, message)
        if message.topic == "/load_frame/sample":
            self.devices.load = message.payload
        elif message.topic == "/stage/sample":
            self.devices.add_stage_sample(message.payload)
        elif message.topic == SEM_ORIGINAL:
            self.originals.add(message.sequence)
            self.counts.add_export(message.sequence)
        elif message.topic == "/drift/estimate":
            self._add_drift(parse_drift_update(message.payload), message.log_time_ns)
        elif message.topic in _DECODED_TOPICS:
            self._add_payload(from_json(message.topic, message.payload), message.log_time_ns)

    def _add_payload(self, payload: Any, time_ns: int) -> None:
        match payload:
            case RunMessage():
                self.run, self.boot_id = self.run or payload, payload.boot_id
            case ClockMessage():
                self.clock = values.clock(payload)
            case StateMessage():
                self.state, self.concluded = payload.after, False
            case CommandMessage(what="ramp_to", args={"force_n": int() | float() as force_n, "rate_n_s": int() | float() as rate_n_s}):
                self.devices.ordered = RampOrder(force_n, rate_n_s)
            case ResultMessage():
                self.concluded = True
            case PairMessage():
                self.pairs[payload.pair] = values.pair_decision(payload)
            case FileMessage(export=int(export)):
                self.counts.add_export(export)
            case ScanMessage():
                self.start_sigma_s = payload.start_sigma_s
            case DicMessage():
                self.field_of_view = field_of_view_event(payload, time_ns) or self.field_of_view
            case FaultMessage(where=where) if where == fault_origin(0):
                self.first_unusable = payload.what

    def _add_drift(self, update: DriftUpdate, time_ns: int) -> None:
        self.counts.revision, self.counts.pairs_analysed = update.revision, update.pairs or update.revision
        if 0 in self.pairs:
            self.drift_forecast = drift_forecast_event(update, self.pairs[0].first.start_time_ns.value, time_ns)
        self.calibration_assessment = calibration_event(update, time_ns)

    def result(self, folder: Path, segment: int, damage: tuple[str, ...]) -> PreviousSegments:
        """Return the state of the run.

        Raises:
            BadConfig: the run is complete, or its first pair cannot be used.
            BadLog: the bytes of a pair are lost.
        """
        if self.state == State.COMPLETE and self.concluded:
            raise BadConfig(f"{folder}: this run is complete; there is nothing to resume")
        if self.first_unusable is not None:
            raise BadConfig(f"{folder}: the first pair of this run cannot be used ({self.first_unusable}); begin a new run")
        completed = tuple(self.pairs[number] for number in sorted(self.pairs))
        for pair in completed:
            lost = [info.name for info in (pair.first, pair.second) if info.export not in self.originals]
            if lost:
                raise BadLog(f"{folder}: the bytes of {lost[0]} of pair {pair.pair} are lost; begin a new run")
        interrupted_run = InterruptedRun(
            completed,
            self.devices.origin_um,
            None if self.devices.load is None else _load(self.devices.load),
            None if self.devices.stage is None else _position(self.devices.stage),
            self.field_of_view,
            self.start_sigma_s,
            drift_forecast=self.drift_forecast,
            calibration_assessment=self.calibration_assessment,
            ramping=self.state == State.RAMPING,
            ordered=self.devices.ordered,
        )
        return PreviousSegments(
            segment,
            interrupted_run,
            self.state,
            self.boot_id,
            self.clock,
            self.counts.last_log_time_ns,
            self.counts.exports,
            self.counts.inputs,
            self.counts.outputs,
            self.counts.revision,
            self.counts.pairs_analysed,
            damage,
            self.alarms,
        )


def _load(payload: bytes) -> LoadSample:
    return values.load_sample(LoadSampleMessage.model_validate_json(payload))


def _position(payload: bytes) -> StageSample:
    return values.stage_sample(StageSampleMessage.model_validate_json(payload))
