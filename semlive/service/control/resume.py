"""State of an interrupted run from its log segments, for resuming.

The log is the only source: pairs, readings and exports up to its truncation. Only the newest message of each kind and the messages of the
pairs are held in memory, so a long log costs time but no memory.
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
    SnapshotMessage,
    StageSampleMessage,
    StateMessage,
    from_json,
)
from semlive.formats.log.reader import LogMessage
from semlive.service.analysis.worker import INPUT_TOPICS, fault_origin, is_output
from semlive.service.config.configuration import Config, parse_config
from semlive.service.control.analysis_events import (
    DriftUpdate,
    calibration_event,
    drift_forecast_event,
    field_of_view_event,
    parse_drift_update,
)
from semlive.service.log.alarms import TOPICS as ALARM_TOPICS
from semlive.service.log.alarms import Alarms, after_message
from semlive.service.log.files import PARTIAL_SUFFIX, SUFFIX, messages, segments

_DECODED_TOPICS = frozenset(
    {"/run", "/clock", "/state", "/command", "/pair", "/sem/file", "/sem/scan", "/dic/summary", "/fault", "/result"}
)
# Configuration keys that may change, because they affect no measurement; all others must be equal.
_CHANGEABLE_KEYS = frozenset({"run.folder", "run.segment_gb", "specimen.yield_strength_mpa", "confirmed_unusual"})


@dataclass(frozen=True, slots=True)
class PreviousSegments:
    """State of a run from its earlier segments.

    Attributes:
        segment: number of the next segment.
        interrupted_run: state of the run for the engine.
        state: state of the protocol at the interruption.
        boot_id: boot of the computer at the interruption.
        clock: the last linear relation of experiment time to the monotonic clock; None if there is none.
        last_log_time_ns: log time of the last message.
        exports: number of the next exported file.
        inputs: number of messages that the analysis has received.
        outputs: number of messages of the analysis in the log.
        revision: revision of the last estimate in the log; 0 if there is none.
        pairs_analysed: number of pairs in that estimate.
        damage: damaged parts of the log, one sentence each.
        alarms: alarms of the earlier segments.
    """

    segment: int
    interrupted_run: InterruptedRun
    state: str
    boot_id: str
    clock: Clock | None
    last_log_time_ns: int
    exports: int
    inputs: int
    outputs: int
    revision: int
    pairs_analysed: int
    damage: tuple[str, ...]
    alarms: Alarms = field(default_factory=Alarms)

    def clock_line(self, boot_id: str) -> Clock | None:
        """Return the clock relation to continue with; None after a reboot of the computer."""
        return self.clock if boot_id and boot_id == self.boot_id else None

    def snapshot(self, time_ns: int) -> SnapshotMessage:
        """Return the first message of the next segment."""
        interrupted_run, boot = self.interrupted_run, {"boot_id": self.boot_id}
        return SnapshotMessage(
            segment=self.segment,
            time_ns=time_ns,
            interrupted_time_ns=self.last_log_time_ns,
            interrupted_boot_id=self.boot_id,
            state=self.state,
            next_step=len(interrupted_run.completed_pairs),
            pairs=len(interrupted_run.completed_pairs),
            exports=self.exports,
            origin_um=interrupted_run.origin_um,
            load=None if interrupted_run.load is None else values.load_sample_message(interrupted_run.load).model_copy(update=boot),
            stage=None
            if interrupted_run.position is None
            else values.stage_sample_message(interrupted_run.position).model_copy(update=boot),
            inputs=self.inputs,
            outputs=self.outputs,
            revision=self.revision,
            pairs_analysed=self.pairs_analysed,
            damage=self.damage,
        )


def read_previous_segments(folder: Path, config: Config) -> PreviousSegments:
    """Read the log of an interrupted run.

    Args:
        folder: run folder.
        config: configuration of the resumed run.

    Raises:
        BadConfig: there is no such run, it is complete, or its configuration differs.
        BadLog: the log cannot be read, or lacks data of its pairs.
    """
    if not folder.is_dir() or not any(path.name.removesuffix(PARTIAL_SUFFIX).endswith(SUFFIX) for path in folder.iterdir()):
        raise BadConfig(f"{folder}: there is no such run to take up again; leave --resume out to begin it")
    reader, damage = _SegmentReader(), list[str]()
    for message in messages(folder, damage.append):
        reader.add(message)
    if reader.run is None:
        raise BadLog(f"{folder}: the log does not tell what was run; begin a run of another name")
    _require_same_configuration(folder, reader.run, config)
    return reader.result(folder, _next_segment(folder), tuple(damage))


@dataclass(slots=True)
class _SegmentReader:
    """Accumulator of the log messages: the newest message of each kind, and all pairs."""

    run: RunMessage | None = None
    boot_id: str = ""
    clock: Clock | None = None
    state: str = State.IDLE
    pairs: dict[int, PairDecision] = field(default_factory=dict)
    ordered: RampOrder | None = None
    originals: set[int] = field(default_factory=set)
    exports: int = 0
    origin_um: tuple[float, float] | None = None
    load: bytes | None = None
    stage: bytes | None = None
    field_of_view: FieldOfViewMeasured | None = None
    start_sigma_s: float | None = None
    first_unusable: str | None = None
    concluded: bool = False
    revision: int = 0
    pairs_analysed: int = 0
    drift_forecast: DriftForecastUpdated | None = None
    calibration_assessment: CalibrationAssessed | None = None
    inputs: int = 0
    outputs: int = 0
    last_log_time_ns: int = 0
    alarms: Alarms = field(default_factory=Alarms)

    def add(self, message: LogMessage) -> None:
        """Add one message of the log."""
        self.inputs += message.topic in INPUT_TOPICS
        self.outputs += is_output(message)
        self.last_log_time_ns = max(self.last_log_time_ns, message.log_time_ns)
        if message.topic in ALARM_TOPICS:
            self.alarms = after_message(self.alarms, message)
        if message.topic == "/load_frame/sample":
            self.load = message.payload
        elif message.topic == "/stage/sample":
            self._add_stage_sample(message.payload)
        elif message.topic == SEM_ORIGINAL:
            self.originals.add(message.sequence)
            self.exports = max(self.exports, message.sequence + 1)
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
                self.ordered = RampOrder(force_n, rate_n_s)
            case ResultMessage():
                self.concluded = True
            case PairMessage():
                self.pairs[payload.pair] = values.pair_decision(payload)
            case FileMessage(export=int(export)):
                self.exports = max(self.exports, export + 1)
            case ScanMessage():
                self.start_sigma_s = payload.start_sigma_s
            case DicMessage():
                self.field_of_view = field_of_view_event(payload, time_ns) or self.field_of_view
            case FaultMessage(where=where) if where == fault_origin(0):
                self.first_unusable = payload.what

    def _add_drift(self, update: DriftUpdate, time_ns: int) -> None:
        self.revision, self.pairs_analysed = update.revision, update.pairs or update.revision
        if 0 in self.pairs:
            self.drift_forecast = drift_forecast_event(update, self.pairs[0].first.start_time_ns.value, time_ns)
        self.calibration_assessment = calibration_event(update, time_ns)

    def _add_stage_sample(self, payload: bytes) -> None:
        self.stage = payload
        if self.origin_um is None:
            first_sample = StageSampleMessage.model_validate_json(payload)
            self.origin_um = (first_sample.x_um, first_sample.y_um)

    def result(self, folder: Path, segment: int, damage: tuple[str, ...]) -> PreviousSegments:
        """Return the state of the run.

        Raises:
            BadConfig: the run is complete, or its first pair cannot be used.
            BadLog: the bytes of a pair are lost.
        """
        if self.state == State.COMPLETE and self.concluded:
            raise BadConfig(f"{folder}: this run is complete; there is nothing to take up again")
        if self.first_unusable is not None:
            raise BadConfig(f"{folder}: the first pair of this run cannot be used ({self.first_unusable}); begin a new run")
        completed = tuple(self.pairs[number] for number in sorted(self.pairs))
        for pair in completed:
            lost = [info.name for info in (pair.first, pair.second) if info.export not in self.originals]
            if lost:
                raise BadLog(f"{folder}: the bytes of {lost[0]} of pair {pair.pair} are lost; begin a new run")
        interrupted_run = InterruptedRun(
            completed,
            self.origin_um,
            None if self.load is None else _load(self.load),
            None if self.stage is None else _position(self.stage),
            self.field_of_view,
            self.start_sigma_s,
            drift_forecast=self.drift_forecast,
            calibration_assessment=self.calibration_assessment,
            ramping=self.state == State.RAMPING,
            ordered=self.ordered,
        )
        return PreviousSegments(
            segment,
            interrupted_run,
            self.state,
            self.boot_id,
            self.clock,
            self.last_log_time_ns,
            self.exports,
            self.inputs,
            self.outputs,
            self.revision,
            self.pairs_analysed,
            damage,
            self.alarms,
        )


def _load(payload: bytes) -> LoadSample:
    return values.load_sample(LoadSampleMessage.model_validate_json(payload))


def _position(payload: bytes) -> StageSample:
    return values.stage_sample(StageSampleMessage.model_validate_json(payload))


def _next_segment(folder: Path) -> int:
    names = (path.name.removesuffix(PARTIAL_SUFFIX).removesuffix(SUFFIX).rpartition(".")[2] for path in segments(folder))
    return 1 + max(int(name) if name.isdecimal() else 0 for name in names)


def _require_same_configuration(folder: Path, run: RunMessage, config: Config) -> None:
    # Validated again, so that a key of a later version has its default in both configurations.
    logged = _flat(parse_config(run.config, f"{folder}: the log's configuration").model_dump(mode="json"))
    configured = _flat(config.model_dump(mode="json"))
    for key in sorted(logged.keys() | configured.keys()):
        if key not in _CHANGEABLE_KEYS and logged.get(key) != configured.get(key):
            raise BadConfig(
                f"{folder}: {key} is {_format_value(configured, key)} in the configuration and {_format_value(logged, key)} in the log; "
                "a run goes on with the configuration that it began with, so correct it, or begin a run of another name"
            )


def _flat(section: Any, place: str = "") -> dict[str, Any]:
    if not isinstance(section, dict) or not section:
        return {place: section}
    return {key: value for name, part in section.items() for key, value in _flat(part, f"{place}.{name}" if place else str(name)).items()}


def _format_value(flat: dict[str, Any], key: str) -> str:
    return "absent" if key not in flat else "empty" if flat[key] is None else str(flat[key])
