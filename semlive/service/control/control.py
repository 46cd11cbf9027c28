"""Control: writes each event to the log, passes it to the engine and executes the commands of the engine.

Control runs in one asyncio loop and never blocks it. Device calls, file reading, correlation and writing run in separate threads or
processes, which return their results through `Control.call_soon`.
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
from semlive.formats.log.reader import LogMessage
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

_DECODED_TOPICS = ("/clock/offset", "/sem/scan", "/sem/file", "/log", "/dic/summary", "/drift/hold", "/elastic", "/fault", "/result")
_FAULT_STATES = (State.FAULT, State.EMERGENCY_STOP)
_ENDING_STATES = (State.STOPPING, *FINAL_STATES)
_WARNING_EVENTS = (DeviceFault, DeviceStopped, LinkLost)
# A driver call that takes longer will not return: the timeouts of drivers are tenths of a second.
_BLOCKED_S = 4.0
_RETRY_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class RunSnapshot:
    """Snapshot of a run for display.

    Attributes:
        time_ns: experiment time.
        progress: status of the protocol.
        drift_rate_px_s: drift rate (x, y) at the newest frame; None before the first pair.
        elastic: elastic constants so far; None before the first.
        pairs_analysed: pairs whose result is in the log.
        warnings: warnings since the run began, one sentence each, newest last.
        alarms: alarms in the log so far, acknowledged or not, newest last.
    """

    time_ns: int
    progress: RunStatus
    drift_rate_px_s: tuple[float, float] | None
    elastic: ElasticMessage | None
    pairs_analysed: int
    warnings: tuple[str, ...]
    alarms: tuple[Alarm, ...] = ()


class Control:
    """Engine state of a run, with its inputs and the execution of its commands; one object per loop."""

    def __init__(
        self,
        plan: Plan,
        clock: SystemClock | SimulatedClock,
        journal: RunLog,
        observe: Callable[[RunSnapshot], None],
        previous: PreviousSegments | None = None,
        auto_resume: bool = False,
    ) -> None:
        """Begin a new run or resume an interrupted one.

        Args:
            plan: the plan of the run.
            clock: experiment time.
            journal: the log of the run.
            observe: callback with a snapshot at every tick.
            previous: state in the earlier segments of the run; None for a new run.
            auto_resume: resume without confirmation by the operator.
        """
        self._clock, self._journal, self._observe = clock, journal, observe
        self._loop = asyncio.get_running_loop()
        self._state: EngineState = start(plan, clock.now_ns(), interrupted_run=None if previous is None else previous.interrupted_run)
        self._auto_resume = auto_resume
        self._links: Mapping[Device, DeviceLink] = {}
        self._trigger: TriggerLink | None = None
        self._blocked: set[Device] = set()
        self._retry_mono_ns: int | None = None
        self._clock_revision = clock.current().revision
        self._drift_rate_px_s: tuple[float, float] | None = None
        self._elastic: ElasticMessage | None = None
        self._pairs_analysed = 0 if previous is None else previous.pairs_analysed
        self._warnings: tuple[str, ...] = ()
        self._closed = False
        self.pairs_done = 0 if previous is None else len(previous.interrupted_run.completed_pairs)
        self._log_behind = False
        self._fault_code = ""
        # Accepts an export folder that replaced the original one; without effect if there is none.
        self.accept_folder: Callable[[], None] = lambda: None
        self.failure: str | None = None
        # Pairs that were found unusable after the last step.
        self.unusable_pairs: tuple[str, ...] = ()
        self.stop_reason: str | None = None
        self.analysis_ready = asyncio.Event()
        self.finished: asyncio.Future[FinishRun] = self._loop.create_future()
        self.troubled = asyncio.Event()

    def connect(self, links: Mapping[Device, DeviceLink], trigger: TriggerLink | None) -> None:
        """Set the links and the trigger that execute commands."""
        self._links, self._trigger = links, trigger
        self.handle(LinksOpening(self._clock.now_ns()))

    def ready(self, load_frame: DeviceIdentity | None, stage: DeviceIdentity | None) -> None:
        """Begin the protocol: all links are open and the analysis is ready."""
        now_ns = self._clock.now_ns()
        self.handle(LinksReady(now_ns, load_frame, stage))
        self._retry_mono_ns = self._clock.mono_ns()
        self._retry_start()

    def operator(self, verb: OperatorCommand, by: str = "") -> None:
        """Log and handle a command of the operator; `by` is its origin, empty for the terminal."""
        now_ns = self._clock.now_ns()
        self._journal.write_message(OperatorMessage(time_ns=now_ns, what=verb, args={"by": by} if by else {}))
        if self._log_behind and verb in (OperatorCommand.START, OperatorCommand.RESUME):
            self._warn(f"cannot {verb}: the log does not keep up")
            return
        if verb in (OperatorCommand.START, OperatorCommand.RESUME):
            self.accept_folder()
        self.handle(OperatorAction(now_ns, verb))

    def tick(self) -> None:
        """Send keep-alive signals to the links, check clock and log, and pass a Tick to the engine."""
        self._guarded(self._tick)

    def _tick(self) -> None:
        for device, link in self._links.items():
            link.keep_alive()
            self._check_link(device, link)
        clock = self._clock.current()
        if clock.revision != self._clock_revision:
            self._clock_revision = clock.revision
            self._journal.write_message(values.clock_message(clock, "the simulation fell behind and stretched its clock"))
        self._check_log(self._journal.recorder.backlog_message)
        self.handle(Tick(self._clock.now_ns()))
        self._retry_start()
        self._observe(self._snapshot())

    def call_soon(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Call a function in the loop; for use by other threads. An exception in the call ends the run."""
        self._loop.call_soon_threadsafe(lambda: None if self._closed else self._guarded(call, *args, **kwargs))

    def fail(self, error: Exception) -> None:
        """Stop all devices, log the error and end the run: after an unexpected exception the state may be wrong."""
        self._stop_all("semlive itself failed")
        if self.failure is None:
            expected = isinstance(error, SemliveError)
            message = " ".join(str(error).split()) or type(error).__name__
            self.failure = message if expected else f"semlive itself failed ({type(error).__name__}: {message}); the log tells where"
            trace = "".join(traceback.format_exception(error))
            # Writing the log may be the cause of the failure.
            with contextlib.suppress(Exception):
                self.trouble(self.failure, "control", "stopped everything and ended the run")
                self._journal.write_text(self._clock.now_ns(), trace, "error")
            with contextlib.suppress(Exception):
                self.handle(OperatorAction(self._clock.now_ns(), OperatorCommand.ABORT))
        if not self.finished.done():
            self.finished.set_result(FinishRun(State.ABORTED, self.failure))

    def close(self) -> None:
        """Ignore all later calls, because the log is being closed."""
        self._closed = True

    def handle(self, event: Event) -> None:
        """Log an event, pass it to the engine and execute the resulting commands."""
        self._record(event)
        if self._state.state in FINAL_STATES:
            return
        before = self._state.state
        self._state, commands = step(self._state, event)
        for command in commands:
            self._execute(command)
        self._update_stop_reason(before, event)

    def _update_stop_reason(self, before: State, event: Event) -> None:
        """Store the reason of a fault for the final message; clear it when the run is resumed."""
        current = self._state.state
        question_open = self._state.calibration_question_open
        if (current in _FAULT_STATES and before is not current) or (question_open and before is State.CALIBRATION_GATE):
            self.stop_reason = progress(self._state).message
            self.troubled.set()
            if not isinstance(event, _WARNING_EVENTS):
                self._warn(self.stop_reason)
                if current in _FAULT_STATES:
                    self._journal.fault(self._clock.now_ns(), self.stop_reason, "protocol", "stopped motion", self._fault_code)
        elif not question_open and current not in (*_FAULT_STATES, *_ENDING_STATES):
            self.stop_reason = None
        if current is State.RESUMING is not before:
            self._warn(progress(self._state).message)

    def on_file_refused(self, name: str, reason: str) -> None:
        """Log a file that the folder watcher rejected."""
        self._journal.refused_file(None, name, reason, self._clock.now_ns())
        self._warn(reason)

    def on_notice(self, what: str) -> None:
        """Log an unusual observation of the folder watcher that is not a fault."""
        self._journal.write_text(self._clock.now_ns(), what, "warning")
        self._warn(what)

    def trouble(self, what: str, where: str, action: str, code: str = "") -> None:
        """Log a fault of semlive itself; `code` is a `FaultCode`."""
        self._journal.fault(self._clock.now_ns(), what, where, action, code)
        self._warn(what)

    def on_analysis_output(self, message: LogMessage) -> None:
        """Log a message of the analysis and pass its events to the engine."""
        payload = from_json(message.topic, message.payload) if message.topic in _DECODED_TOPICS else None
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
            self._handle_field_of_view(payload)
        elif message.topic == "/drift/estimate":
            self._handle_drift(parse_drift_update(message.payload))
        elif isinstance(payload, HoldDriftMessage):
            self.handle(HoldDriftMeasured(self._clock.now_ns(), payload.begin_time_ns, math.hypot(*payload.rate_px_s)))
        elif isinstance(payload, ElasticMessage):
            self._elastic = payload
        elif isinstance(payload, FaultMessage):
            self._warn(payload.what)
            if not is_model_warning(payload):
                self._pair_unusable(payload.what)

    def _handle_drift(self, update: DriftUpdate) -> None:
        """Store the drift rate; pass drift forecast and assessment of the calibration to the engine."""
        self._pairs_analysed, reference = update.pairs or update.revision, self._state.reference
        if update.rate_x_px_s is not None and update.rate_y_px_s is not None:
            self._drift_rate_px_s = update.rate_x_px_s, update.rate_y_px_s
        if reference is not None:
            now_ns = self._clock.now_ns()
            calibration = calibration_event(update, now_ns)
            for event in (drift_forecast_event(update, reference.start_time_ns.value, now_ns), *([calibration] if calibration else [])):
                self.handle(event)

    def _pair_unusable(self, reason: str) -> None:
        """Stop the run with a fault: all maps refer to the first pair, and the cause may affect the following pairs too."""
        message = f"{'a' if self._pairs_analysed else 'the first'} pair cannot be used: {reason}"
        if self._state.state in FINAL_STATES:
            self.unusable_pairs += (message,)
        else:
            self.handle(DeviceFault(self._clock.now_ns(), Device.SEM, message))

    def _handle_field_of_view(self, message: DicMessage) -> None:
        """Pass the displacement of the field of view since frame 0 to the engine, if most points converged."""
        measured = field_of_view_event(message, self._clock.now_ns())
        if measured is not None:
            self.handle(measured)

    def _guarded(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Call a function and end the run after an exception, which asyncio would only print."""
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
        elif isinstance(event, _WARNING_EVENTS):
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

    def _check_link(self, device: Device, link: DeviceLink) -> None:
        """Report a link thread that is blocked in its driver: it can neither report this nor stop the device."""
        if link.blocked_s < _BLOCKED_S:
            self._blocked.discard(device)
        elif device not in self._blocked:
            self._blocked.add(device)
            reason = f"its driver has not come back for {_BLOCKED_S:g} s, so it cannot be told to stop: stop the machine by hand"
            self.handle(LinkLost(self._clock.now_ns(), device, reason))

    def _check_log(self, backlog: str | None) -> None:
        """Pause the run while the log does not keep up, so that no data are lost; only the operator resumes it."""
        if (backlog is not None) == self._log_behind:
            return
        self._log_behind = backlog is not None
        if backlog is not None:
            self.trouble(backlog, "log", "paused the run; messages are kept in memory meanwhile", FaultCode.LOG)
            self.handle(OperatorAction(self._clock.now_ns(), OperatorCommand.PAUSE, backlog))
            self.troubled.set()
        else:
            self._journal.write_text(self._clock.now_ns(), "the log keeps up again; resume when you are ready")
            self._warn("the log keeps up again; resume when you are ready")

    def _retry_start(self) -> None:
        """Repeat a start, or an automatic resume, that was rejected because there was no fresh reading."""
        retry_mono_ns = self._retry_mono_ns
        if retry_mono_ns is None or self._clock.mono_ns() < retry_mono_ns:
            return
        self._retry_mono_ns = self._clock.mono_ns() + _RETRY_NS
        if self._log_behind:
            return
        if self._state.state is State.READY:
            self.operator(OperatorCommand.START)
        elif self._state.state is State.RESUMING and self._auto_resume:
            self._resume_without_confirmation()
        else:
            self._retry_mono_ns = None

    def _resume_without_confirmation(self) -> None:
        """Resume without confirmation; if the devices differ from the log, report a fault and wait for the operator."""
        change = changed_since(self._state)
        if change is None:
            self.operator(OperatorCommand.RESUME)
            return
        self._retry_mono_ns = None
        self.stop_reason = f"the run is not resumed by itself, because {change.reason}"
        self.trouble(self.stop_reason, "protocol", "ordered nothing; resume when you have looked at the machine", change.code)
        self.troubled.set()

    def _warn(self, text: str) -> None:
        self._warnings = (*self._warnings, text)[-50:]

    def _snapshot(self) -> RunSnapshot:
        now_ns = self._clock.now_ns()
        alarms, rate = self._journal.alarms.listed, self._drift_rate_px_s
        return RunSnapshot(now_ns, progress(self._state), rate, self._elastic, self._pairs_analysed, self._warnings, alarms)
