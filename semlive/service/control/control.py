"""Control: everything that happens goes into the log, then to the engine; what the engine wants is done.

It runs in one asyncio loop and never blocks it; device calls, file reading, correlation and writing have threads or
processes of their own that come back through `Control.call_soon`.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ParamSpec

from semlive.data.experiment import Plan
from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity
from semlive.engine import (
    FINAL_STATES,
    AcceptPair,
    Command,
    Device,
    DeviceFault,
    DeviceStopped,
    EngineState,
    Event,
    FinishRun,
    FrameScanned,
    FrameUnreadable,
    HoldDriftMeasured,
    LinkLost,
    LinksOpening,
    LinksReady,
    LoadReading,
    MoveStage,
    Notify,
    OperatorAction,
    OperatorCommand,
    RampTo,
    RejectFrame,
    RunStatus,
    StageReading,
    State,
    StopMotion,
    Tick,
    Transition,
    TriggerFrame,
    changed_since,
    progress,
    start,
    step,
)
from semlive.engine.load_history import frame_load
from semlive.errors import SemliveError
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import (
    ClockOffsetMessage,
    DicMessage,
    ElasticMessage,
    FaultMessage,
    FileMessage,
    HoldDriftMessage,
    LogLineMessage,
    OperatorMessage,
    ScanMessage,
    from_json,
)
from semlive.formats.log.writer import LogMessage
from semlive.service.analysis.worker import READY_TEXT, is_model_warning
from semlive.service.control.analysis_events import (
    DriftUpdate,
    calibration_event,
    drift_forecast_event,
    field_of_view_event,
    parse_drift_update,
)
from semlive.service.control.device_link import DeviceLink
from semlive.service.control.resume import PreviousSegments
from semlive.service.control.trigger import TriggerLink
from semlive.service.log.alarms import Alarm
from semlive.service.log.run_log import RunLog
from semlive.service.runtime.clock import SimulatedClock, SystemClock

P = ParamSpec("P")

_DECODED = ("/clock/offset", "/sem/scan", "/sem/file", "/log", "/dic/summary", "/drift/hold", "/elastic", "/fault", "/result")
_TROUBLE = (State.FAULT, State.EMERGENCY_STOP)
_ENDING = (State.STOPPING, *FINAL_STATES)
_WARNED = (DeviceFault, DeviceStopped, LinkLost)
# A driver that is away for longer will not come back: its own timeouts are tenths of a second.
_AWAY_S = 4.0
_AGAIN_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class RunSnapshot:
    """A run as faces see it.

    Attributes:
        time_ns: experiment time.
        progress: of the protocol.
        drift_rate_px_s: at the newest frame, or None before the first pair.
        elastic: elastic constants so far.
        pairs_analysed: pairs whose result is in the log.
        warnings: sentences since the run began, newest last.
        alarms: of the log so far, acknowledged or not, newest last.
    """

    time_ns: int
    progress: RunStatus
    drift_rate_px_s: tuple[float, float] | None
    elastic: ElasticMessage | None
    pairs_analysed: int
    warnings: tuple[str, ...]
    alarms: tuple[Alarm, ...] = ()


class Control:
    """The loop's one object: the engine's state, and everything that feeds it or obeys it."""

    def __init__(
        self,
        plan: Plan,
        clock: SystemClock | SimulatedClock,
        journal: RunLog,
        observe: Callable[[RunSnapshot], None],
        earlier: PreviousSegments | None = None,
        go_on: bool = False,
    ) -> None:
        """A run that begins, or one that is taken up again.

        Args:
            plan: what is to be done.
            clock: experiment time.
            journal: where everything is written down.
            observe: gets a snapshot with every tick.
            earlier: what the run's earlier segments tell.
            go_on: the operator's answer to the question of a run that is taken up again, given beforehand.
        """
        self._clock, self._journal, self._observe = clock, journal, observe
        self._loop = asyncio.get_running_loop()
        self._state: EngineState = start(plan, clock.now_ns(), interrupted_run=None if earlier is None else earlier.interrupted_run)
        self._go_on = go_on
        self._links: Mapping[Device, DeviceLink] = {}
        self._trigger: TriggerLink | None = None
        self._away: set[Device] = set()
        self._start_again_mono_ns: int | None = None
        self._clock_revision = clock.current().revision
        self._drift_rate_px_s: tuple[float, float] | None = None
        self._elastic: ElasticMessage | None = None
        self._pairs_analysed = 0 if earlier is None else earlier.pairs_analysed
        self._warnings: tuple[str, ...] = ()
        self._closed = False
        self.pairs_done = 0 if earlier is None else len(earlier.interrupted_run.completed_pairs)
        self._log_behind = False
        self._fault_code = ""
        # Lets the watcher take files from an export folder that stands in the place of another; nothing if there is none such.
        self.accept_folder: Callable[[], None] = lambda: None
        self.failure: str | None = None
        # Pairs that turned out to be of no use when every step was done already.
        self.unusable_pairs: tuple[str, ...] = ()
        self.stop_reason: str | None = None
        self.analysis_ready = asyncio.Event()
        self.finished: asyncio.Future[FinishRun] = self._loop.create_future()
        self.troubled = asyncio.Event()

    def connect(self, links: Mapping[Device, DeviceLink], trigger: TriggerLink | None) -> None:
        """Who obeys from now on."""
        self._links, self._trigger = links, trigger
        self.handle(LinksOpening(self._clock.now_ns()))

    def ready(self, load_frame: DeviceIdentity | None, stage: DeviceIdentity | None) -> None:
        """All links are open and analysis is warm: begin."""
        now_ns = self._clock.now_ns()
        self.handle(LinksReady(now_ns, load_frame, stage))
        self._start_again_mono_ns = self._clock.mono_ns()
        self._start_again()

    def operator(self, verb: OperatorCommand, by: str = "") -> None:
        """The operator said something, here or elsewhere."""
        now_ns = self._clock.now_ns()
        self._journal.write_message(OperatorMessage(time_ns=now_ns, what=verb, args={"by": by} if by else {}))
        if self._log_behind and verb in (OperatorCommand.START, OperatorCommand.RESUME):
            self._warn(f"cannot {verb}: the log does not keep up")
            return
        if verb in (OperatorCommand.START, OperatorCommand.RESUME):
            self.accept_folder()
        self.handle(OperatorAction(now_ns, verb))

    def tick(self) -> None:
        """Time passes: feed the links, look at the clock, let the engine decide."""
        self._guarded(self._tick)

    def _tick(self) -> None:
        for device, link in self._links.items():
            link.keep_alive()
            self._look_for(device, link)
        clock = self._clock.current()
        if clock.revision != self._clock_revision:
            self._clock_revision = clock.revision
            self._journal.write_message(values.clock_message(clock, "the simulation fell behind and stretched its clock"))
        self._look_at_log(self._journal.recorder.backlog_message)
        self.handle(Tick(self._clock.now_ns()))
        self._start_again()
        self._observe(self._snapshot())

    def call_soon(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Let the loop call something; the door for every other thread. If it raises, the run is over."""
        self._loop.call_soon_threadsafe(lambda: None if self._closed else self._guarded(call, *args, **kwargs))

    def fail(self, error: Exception) -> None:
        """What we believe of the run may be wrong from here on: stop everything, write down why, end the run."""
        self._stop_all("semlive itself failed")
        if self.failure is None:
            known = isinstance(error, SemliveError)
            what = " ".join(str(error).split()) or type(error).__name__
            self.failure = what if known else f"semlive itself failed ({type(error).__name__}: {what}); the log tells where"
            told = "".join(traceback.format_exception(error))
            # Writing it down may be just what fails.
            with contextlib.suppress(Exception):
                self.trouble(self.failure, "control", "stopped everything and ended the run")
                self._journal.write_text(self._clock.now_ns(), told, "error")
            with contextlib.suppress(Exception):
                self.handle(OperatorAction(self._clock.now_ns(), OperatorCommand.ABORT))
        if not self.finished.done():
            self.finished.set_result(FinishRun(State.ABORTED, self.failure))

    def close(self) -> None:
        """What still comes is too late: the log is being closed."""
        self._closed = True

    def handle(self, event: Event) -> None:
        """Record an event, let the engine decide, do what it wants."""
        self._record(event)
        if self._state.state in FINAL_STATES:
            return
        before = self._state.state
        self._state, commands = step(self._state, event)
        for command in commands:
            self._execute(command)
        self._judge(before, event)

    def _judge(self, before: State, event: Event) -> None:
        """Keep the reason of a trouble for the last sentence; whoever resumes is done with it."""
        at = self._state.state
        asks = self._state.calibration_question_open
        if (at in _TROUBLE and before is not at) or (asks and before is State.CALIBRATION_GATE):
            self.stop_reason = progress(self._state).message
            self.troubled.set()
            if not isinstance(event, _WARNED):
                self._warn(self.stop_reason)
                if at in _TROUBLE:
                    self._journal.fault(self._clock.now_ns(), self.stop_reason, "protocol", "stopped motion", self._fault_code)
        elif not asks and at not in (*_TROUBLE, *_ENDING):
            self.stop_reason = None
        if at is State.RESUMING is not before:
            self._warn(progress(self._state).message)

    def on_file_refused(self, name: str, reason: str) -> None:
        """The watcher refused a file."""
        self._journal.refused_file(None, name, reason, self._clock.now_ns())
        self._warn(reason)

    def on_notice(self, what: str) -> None:
        """The watcher saw something unusual that is no trouble."""
        self._journal.write_text(self._clock.now_ns(), what, "warning")
        self._warn(what)

    def trouble(self, what: str, where: str, action: str, code: str = "") -> None:
        """Something of ours went wrong; `code` is a `FaultCode`."""
        self._journal.fault(self._clock.now_ns(), what, where, action, code)
        self._warn(what)

    def on_analysis_output(self, message: LogMessage) -> None:
        """Something analysis said."""
        payload = from_json(message.topic, message.payload) if message.topic in _DECODED else None
        if isinstance(payload, ScanMessage):
            info = values.frame_info(payload)
            self._journal.scan(info, frame_load(self._state.history, info.start_time_ns.value, info.end_time_ns))
            self.handle(FrameScanned(self._clock.now_ns(), info))
            return
        self._journal.output(message)
        if isinstance(payload, FileMessage) and payload.export is not None:
            self._warn(payload.reason)
            self.handle(FrameUnreadable(self._clock.now_ns(), payload.export, payload.reason))
        elif isinstance(payload, ClockOffsetMessage) and payload.advice:
            self._warn(payload.advice)
        elif isinstance(payload, LogLineMessage) and payload.text == READY_TEXT:
            self.analysis_ready.set()
        elif isinstance(payload, DicMessage):
            self._field(payload)
        elif message.topic == "/drift/estimate":
            self._drift(parse_drift_update(message.payload))
        elif isinstance(payload, HoldDriftMessage):
            self.handle(HoldDriftMeasured(self._clock.now_ns(), payload.begin_time_ns, math.hypot(*payload.rate_px_s)))
        elif isinstance(payload, ElasticMessage):
            self._elastic = payload
        elif isinstance(payload, FaultMessage):
            self._warn(payload.what)
            if not is_model_warning(payload):
                self._pair_unusable(payload.what)

    def _drift(self, word: DriftUpdate) -> None:
        """How fast the drift is, and what the calibration is worth."""
        self._pairs_analysed, zero = word.pairs or word.revision, self._state.reference
        if word.rate_x_px_s is not None and word.rate_y_px_s is not None:
            self._drift_rate_px_s = word.rate_x_px_s, word.rate_y_px_s
        if zero is not None:
            now_ns = self._clock.now_ns()
            judged = calibration_event(word, now_ns)
            for event in (drift_forecast_event(word, zero.start_time_ns.value, now_ns), *([judged] if judged else [])):
                self.handle(event)

    def _pair_unusable(self, why: str) -> None:
        """Every later frame is measured from the first pair; what spoilt a later one may spoil the next, and spend the specimen on it."""
        what = f"{'a' if self._pairs_analysed else 'the first'} pair cannot be used: {why}"
        if self._state.state in FINAL_STATES:
            self.unusable_pairs += (what,)
        else:
            self.handle(DeviceFault(self._clock.now_ns(), Device.SEM, what))

    def _field(self, message: DicMessage) -> None:
        """Where the field of view went since frame 0, if most of it was found again."""
        seen = field_of_view_event(message, self._clock.now_ns())
        if seen is not None:
            self.handle(seen)

    def _guarded(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """In asyncio an exception in a callback is a line on the terminal, and the run would go on without it."""
        try:
            call(*args, **kwargs)
        except Exception as error:
            self.fail(error)

    def _stop_all(self, reason: str) -> None:
        for link in self._links.values():
            link.stop(reason)

    def _record(self, event: Event) -> None:
        if isinstance(event, LoadReading | StageReading):
            self._journal.sample(event.sample)
        elif isinstance(event, _WARNED):
            code = FaultCode.LINK_LOST if isinstance(event, LinkLost) else event.code
            self._journal.fault(event.time_ns, event.reason, event.device.words, "told the engine", code)
            self._warn(f"{event.device.words}: {event.reason}")

    def _execute(self, command: Command) -> None:
        now_ns = self._clock.now_ns()
        if isinstance(command, Transition):
            self._journal.transition(command)
            self._fault_code = "" if command.code is None else command.code
        elif isinstance(command, RampTo):
            self._journal.command(now_ns, "ramp_to", {"force_n": command.force_n, "rate_n_s": command.rate_n_s}, "sent")
            self._links[Device.LOAD_FRAME].send(command)
        elif isinstance(command, MoveStage):
            moves = self._links[Device.STAGE].stage_kind or "unknown"
            self._journal.command(now_ns, "move_stage", {"x_um": command.x_um, "y_um": command.y_um, "moves": moves}, "sent")
            self._links[Device.STAGE].send(command)
        elif isinstance(command, StopMotion):
            self._stop_all(command.reason)
            self._journal.command(now_ns, "stop", {"reason": command.reason}, "sent")
        elif isinstance(command, TriggerFrame):
            self._journal.command(now_ns, "trigger", {}, "sent")
            if self._trigger is not None:
                self._trigger.request_scan()
        elif isinstance(command, AcceptPair):
            self._journal.pair(command.decision)
        elif isinstance(command, RejectFrame):
            self._journal.refused_file(command.export, "", command.reason, now_ns)
        elif isinstance(command, Notify):
            self._journal.write_text(now_ns, command.text)
        elif not self.finished.done():
            self._journal.write_text(now_ns, command.text)
            self.finished.set_result(command)

    def _look_for(self, device: Device, link: DeviceLink) -> None:
        """A link thread that its driver keeps away cannot say so itself, and cannot stop the device either."""
        if link.blocked_s < _AWAY_S:
            self._away.discard(device)
        elif device not in self._away:
            self._away.add(device)
            reason = f"its driver has not come back for {_AWAY_S:g} s, so it cannot be told to stop: stop the machine by hand"
            self.handle(LinkLost(self._clock.now_ns(), device, reason))

    def _look_at_log(self, behind: str | None) -> None:
        """Nothing is acquired that could not be written down: the run pauses, and only the operator takes it up again."""
        if (behind is not None) == self._log_behind:
            return
        self._log_behind = behind is not None
        if behind is not None:
            self.trouble(behind, "log", "paused the run; messages are kept in memory meanwhile", FaultCode.LOG)
            self.handle(OperatorAction(self._clock.now_ns(), OperatorCommand.PAUSE, behind))
            self.troubled.set()
        else:
            self._journal.write_text(self._clock.now_ns(), "the log keeps up again; resume when you are ready")
            self._warn("the log keeps up again; resume when you are ready")

    def _start_again(self) -> None:
        """A start that was refused (no fresh reading at that instant) is asked for again; nobody else would."""
        due = self._start_again_mono_ns
        if due is None or self._clock.mono_ns() < due:
            return
        self._start_again_mono_ns = self._clock.mono_ns() + _AGAIN_NS
        if self._log_behind:
            return
        if self._state.state is State.READY:
            self.operator(OperatorCommand.START)
        elif self._state.state is State.RESUMING and self._go_on:
            self._resume_as_told()
        else:
            self._start_again_mono_ns = None

    def _resume_as_told(self) -> None:
        """Resume with the answer given beforehand; where the devices differ from the log, that is a fault and the operator is asked."""
        other = changed_since(self._state)
        if other is None:
            self.operator(OperatorCommand.RESUME)
            return
        self._start_again_mono_ns = None
        self.stop_reason = f"the run is not resumed by itself, because {other.reason}"
        self.trouble(self.stop_reason, "protocol", "ordered nothing; resume when you have looked at the machine", other.code)
        self.troubled.set()

    def _warn(self, text: str) -> None:
        self._warnings = (*self._warnings, text)[-50:]

    def _snapshot(self) -> RunSnapshot:
        now_ns = self._clock.now_ns()
        alarms, rate = self._journal.alarms.known, self._drift_rate_px_s
        return RunSnapshot(now_ns, progress(self._state), rate, self._elastic, self._pairs_analysed, self._warnings, alarms)
