"""What the segments of an interrupted run tell, so that it can be taken up again.

The log alone is asked: pairs, readings and exports up to where it was torn. Nothing is kept in memory but the newest of each and the
pairs' own words, so a long log costs time and no space.
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
from semlive.formats.log.writer import LogMessage
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

_READ = frozenset({"/run", "/clock", "/state", "/command", "/pair", "/sem/file", "/sem/scan", "/dic/summary", "/fault", "/result"})
# Where the log lies is known by its being found there, and into what it is cut concerns no measurement; everything else has to be the same.
_MAY_DIFFER = frozenset({"run.folder", "run.segment_gb", "specimen.yield_strength_mpa", "confirmed_unusual"})


@dataclass(frozen=True, slots=True)
class PreviousSegments:
    """The earlier segments of a run.

    Attributes:
        segment: number of the segment that comes next.
        interrupted_run: what the engine has to know.
        state: of the protocol when it broke off.
        boot_id: boot of the computer then.
        clock: the last line of experiment time.
        last_log_time_ns: of the last message.
        exports: number of the next exported file.
        inputs: messages that analysis has been given.
        outputs: messages of analysis in the log.
        revision: of the last estimate in the log, 0 if there is none.
        pairs_analysed: how many pairs it is from.
        damage: what could not be read, one sentence each.
        alarms: those of the earlier segments.
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
        """The line of experiment time to go on with: the same while the computer was not started anew, else none."""
        return self.clock if boot_id and boot_id == self.boot_id else None

    def snapshot(self, time_ns: int) -> SnapshotMessage:
        """The message with which the next segment begins."""
        before, boot = self.interrupted_run, {"boot_id": self.boot_id}
        return SnapshotMessage(
            segment=self.segment,
            time_ns=time_ns,
            interrupted_time_ns=self.last_log_time_ns,
            interrupted_boot_id=self.boot_id,
            state=self.state,
            next_step=len(before.completed_pairs),
            pairs=len(before.completed_pairs),
            exports=self.exports,
            origin_um=before.origin_um,
            load=None if before.load is None else values.load_sample_message(before.load).model_copy(update=boot),
            stage=None if before.position is None else values.stage_sample_message(before.position).model_copy(update=boot),
            inputs=self.inputs,
            outputs=self.outputs,
            revision=self.revision,
            pairs_analysed=self.pairs_analysed,
            damage=self.damage,
        )


def read_previous_segments(folder: Path, config: Config) -> PreviousSegments:
    """Read an interrupted run.

    Args:
        folder: of the run.
        config: with which it is to go on.

    Raises:
        BadConfig: there is no such run, it is complete already, or its configuration was another one.
        BadLog: its log cannot be read, or lacks what its pairs need.
    """
    if not folder.is_dir() or not any(path.name.removesuffix(PARTIAL_SUFFIX).endswith(SUFFIX) for path in folder.iterdir()):
        raise BadConfig(f"{folder}: there is no such run to take up again; leave --resume out to begin it")
    reading, damage = _Reading(), list[str]()
    for message in messages(folder, damage.append):
        reading.take(message)
    if reading.run is None:
        raise BadLog(f"{folder}: the log does not tell what was run; begin a run of another name")
    _same_configuration(folder, reading.run, config)
    return reading.told(folder, _next_segment(folder), tuple(damage))


@dataclass(slots=True)
class _Reading:
    """The newest of everything so far."""

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
    seen: FieldOfViewMeasured | None = None
    start_sigma_s: float | None = None
    first_unusable: str | None = None
    concluded: bool = False
    revision: int = 0
    pairs_analysed: int = 0
    foreseen: DriftForecastUpdated | None = None
    judged: CalibrationAssessed | None = None
    inputs: int = 0
    outputs: int = 0
    last_log_time_ns: int = 0
    alarms: Alarms = field(default_factory=Alarms)

    def take(self, message: LogMessage) -> None:
        """One message of the log."""
        self.inputs += message.topic in INPUT_TOPICS
        self.outputs += is_output(message)
        self.last_log_time_ns = max(self.last_log_time_ns, message.log_time_ns)
        if message.topic in ALARM_TOPICS:
            self.alarms = after_message(self.alarms, message)
        if message.topic == "/load_frame/sample":
            self.load = message.payload
        elif message.topic == "/stage/sample":
            self._stage(message.payload)
        elif message.topic == SEM_ORIGINAL:
            self.originals.add(message.sequence)
            self.exports = max(self.exports, message.sequence + 1)
        elif message.topic == "/drift/estimate":
            self._drift(parse_drift_update(message.payload), message.log_time_ns)
        elif message.topic in _READ:
            self._take(from_json(message.topic, message.payload), message.log_time_ns)

    def _take(self, payload: Any, time_ns: int) -> None:
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
                self.seen = field_of_view_event(payload, time_ns) or self.seen
            case FaultMessage(where=where) if where == fault_origin(0):
                self.first_unusable = payload.what

    def _drift(self, word: DriftUpdate, time_ns: int) -> None:
        self.revision, self.pairs_analysed = word.revision, word.pairs or word.revision
        if 0 in self.pairs:
            self.foreseen = drift_forecast_event(word, self.pairs[0].first.start_time_ns.value, time_ns)
        self.judged = calibration_event(word, time_ns)

    def _stage(self, payload: bytes) -> None:
        self.stage = payload
        if self.origin_um is None:
            first = StageSampleMessage.model_validate_json(payload)
            self.origin_um = (first.x_um, first.y_um)

    def told(self, folder: Path, segment: int, damage: tuple[str, ...]) -> PreviousSegments:
        """All of it.

        Raises:
            BadConfig: the run is complete, or its first pair cannot be used.
            BadLog: the bytes of a pair are lost.
        """
        if self.state == State.COMPLETE and self.concluded:
            raise BadConfig(f"{folder}: this run is complete; there is nothing to take up again")
        if self.first_unusable is not None:
            raise BadConfig(f"{folder}: the first pair of this run cannot be used ({self.first_unusable}); begin a new run")
        done = tuple(self.pairs[number] for number in sorted(self.pairs))
        for one in done:
            lost = [info.name for info in (one.first, one.second) if info.export not in self.originals]
            if lost:
                raise BadLog(f"{folder}: the bytes of {lost[0]} of pair {one.pair} are lost; begin a new run")
        before = InterruptedRun(
            done,
            self.origin_um,
            None if self.load is None else _load(self.load),
            None if self.stage is None else _position(self.stage),
            self.seen,
            self.start_sigma_s,
            drift_forecast=self.foreseen,
            calibration_assessment=self.judged,
            ramping=self.state == State.RAMPING,
            ordered=self.ordered,
        )
        return PreviousSegments(
            segment,
            before,
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


def _same_configuration(folder: Path, run: RunMessage, config: Config) -> None:
    # Checked anew, so that a key that came with a later version has its default in both.
    then = _flat(parse_config(run.config, f"{folder}: the log's configuration").model_dump(mode="json"))
    now = _flat(config.model_dump(mode="json"))
    for key in sorted(then.keys() | now.keys()):
        if key not in _MAY_DIFFER and then.get(key) != now.get(key):
            raise BadConfig(
                f"{folder}: {key} is {_told(now, key)} in the configuration and {_told(then, key)} in the log; "
                "a run goes on with the configuration that it began with, so correct it, or begin a run of another name"
            )


def _flat(given: Any, place: str = "") -> dict[str, Any]:
    if not isinstance(given, dict) or not given:
        return {place: given}
    return {key: value for name, part in given.items() for key, value in _flat(part, f"{place}.{name}" if place else str(name)).items()}


def _told(flat: dict[str, Any], key: str) -> str:
    return "absent" if key not in flat else "empty" if flat[key] is None else str(flat[key])
