"""The daemon: start-up, event loop and shutdown. In every case the load frame is stopped and the log is finished."""

from __future__ import annotations

import asyncio
import contextlib
import os
import queue
import shutil
import signal
import socket
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity
from semlive.engine import Device, DeviceFault, FinishRun, OperatorAction, OperatorCommand, State, start
from semlive.errors import BadConfig, BadInput, SemliveError
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import RunMessage
from semlive.service.analysis.process import AnalysisProcess
from semlive.service.config.configuration import Config
from semlive.service.control.control import Control, RunSnapshot
from semlive.service.control.device_link import DeviceLink
from semlive.service.control.handoff import BoundedHandoff
from semlive.service.control.operator_prompts import OperatorPrompts
from semlive.service.control.refused_start import REFUSED_START, named_in, refusal_code, remove_refused_start
from semlive.service.control.resume import PreviousSegments, read_previous_segments
from semlive.service.control.socket import ControlSocket, SocketAddress
from semlive.service.control.start_checks import require_attendance, require_orders
from semlive.service.control.systemd import SystemdNotifier
from semlive.service.control.trigger import TriggerLink
from semlive.service.log.alarms import AcknowledgeAll, acknowledgements
from semlive.service.log.files import segment_path
from semlive.service.log.lock import held_itself, only_one_at, run_lock
from semlive.service.log.recording import Recorder
from semlive.service.log.repair import repair_partial_segments
from semlive.service.log.run_log import RunLog
from semlive.service.runtime import drivers
from semlive.service.runtime.clock import SimulatedClock, SystemClock, open_clock
from semlive.service.runtime.process import boot_id
from semlive.service.runtime.versions import versions
from semlive.service.watch.clock_offsets import probe_share
from semlive.service.watch.thread import FolderWatcher
from semlive.service.watch.watch_settings import WatchSettings

_TICK_S = 0.05
_OPEN_TIMEOUT_S = 10.0
_LOG_TIMEOUT_S = 10.0
# The timeout for a disk that rejects writes at the end of the run is shorter than for a slow disk.
_LOG_REFUSED_S = 3.0
# Longest time without a result while the remaining pairs are analysed after the end of the protocol. Results are seconds apart, or the
# start-up time of a new child process; the conclusion of 22 pairs took two minutes on a busy computer.
_ANALYSIS_QUIET_S = 300.0
# Compiling for the first time takes half a minute on 2 cores.
_READY_TIMEOUT_S = 300.0
# The pairs of a resumed run are first correlated again: at 16 million pixels a pair takes some seconds.
_READY_TIMEOUT_PER_PAIR_S = 20.0
# SIGHUP: the terminal was closed; SIGBREAK: likewise, and Ctrl-Break, on Windows.
_STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Outcome of a run.

    Attributes:
        log: run folder.
        complete: every step was executed.
        text: one sentence.
    """

    log: Path
    complete: bool
    text: str


@dataclass(frozen=True, slots=True)
class RunInterface:
    """Connections of a run to display and operator.

    Attributes:
        observe: callback with a snapshot at every tick, in the loop; must not block.
        commands: queue of commands of the operator, filled from any thread.
        attended: a person stays at the instrument.
        stop_on_fault: end the run at a fault instead of waiting for the operator.
        resume: resume an interrupted run instead of beginning one.
        auto_resume: resume without confirmation if the devices agree with the last readings in the log.
        on_socket_open: callback with the address of the control socket once it is open, in the loop; must not block. None: no socket.
    """

    observe: Callable[[RunSnapshot], None]
    commands: queue.SimpleQueue[OperatorCommand | AcknowledgeAll]
    attended: bool = False
    stop_on_fault: bool = False
    resume: bool = False
    auto_resume: bool = False
    on_socket_open: Callable[[SocketAddress], object] | None = None


def run_experiment(config: Config, interface: RunInterface) -> RunOutcome:
    """Run an experiment from start-up to the finished log.

    Raises:
        BadInput: configuration, folder or socket are invalid; nothing was moved.
        SemliveError: the run could not be started or finished.
    """
    return asyncio.run(_Daemon(config, interface).run())


class _Daemon:
    def __init__(self, config: Config, faces: RunInterface) -> None:
        self._config, self._interface = config, faces
        self._folder = config.run.folder / config.run.name
        self._versions = versions(("numpy", "scipy", "numba", "mcap"))
        self._supervisor = SystemdNotifier(os.environ)
        self._signals = 0
        self._skip_analysis = False
        self._log_ended = False
        self._control: Control | None = None
        self._started = False
        self._opened_devices = False
        self._replaced_start: str | None = None
        self._acknowledge: Callable[[str | None, str], bool] = lambda *_: False

    async def run(self) -> RunOutcome:
        watch = self._config.watch_settings()
        if not watch.folder.is_dir():
            raise BadConfig(f"sem.folder {watch.folder}: no such folder; create it or correct the path")
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._signal_handlers())
            watchdog = asyncio.create_task(self._supervisor.watchdog())
            stack.callback(watchdog.cancel)
            stack.callback(self._supervisor.stopping)
            previous = self._previous_segments(stack) if self._interface.resume else None
            clock = self._open_clock(previous)
            # A plan that violates its limits is rejected before anything is written.
            start(self._config.plan(), clock.now_ns(), interrupted_run=None if previous is None else previous.interrupted_run)
            watch = replace(watch, first_export=0 if previous is None else previous.exports)
            journal, recorder = self._open_log(stack, clock, previous)
            self._control = control = Control(
                self._config.plan(), clock, journal, self._interface.observe, previous, self._interface.auto_resume
            )
            stack.callback(control.close)
            asyncio.get_running_loop().set_exception_handler(lambda _, context: control.call_soon(_log_loop_error, journal, clock, context))
            if self._signals:  # received before control existed
                control.call_soon(control.operator, OperatorCommand.STOP)
            try:
                return await self._experiment(stack, clock, watch, journal, recorder, previous)
            except SemliveError:
                raise
            except Exception as error:
                control.fail(error)
                raise SemliveError(control.failure or str(error)) from error

    async def _experiment(
        self,
        stack: contextlib.ExitStack,
        clock: SystemClock | SimulatedClock,
        watch: WatchSettings,
        journal: RunLog,
        recorder: Recorder,
        previous: PreviousSegments | None,
    ) -> RunOutcome:
        """Run from the open log to the finished log; the stack closes in reverse order, devices first."""
        control, loop = self._running(), asyncio.get_running_loop()
        self._acknowledge = partial(_acknowledge, journal, clock)
        analysis = AnalysisProcess(
            self._folder,
            lambda: recorder.write_failed,
            BoundedHandoff(control.call_soon, control.on_analysis_output),
            lambda message, lost: control.call_soon(_analysis_trouble, control, clock, message, lost),
            (0, 0) if previous is None else (previous.inputs, previous.outputs),
        )
        stack.callback(analysis.close, 5.0)
        journal.subscribe(analysis.notify_input)
        journal.write_message(self._run_message(clock, 0 if previous is None else previous.segment))
        if previous is not None:
            journal.write_message(previous.snapshot(clock.now_ns()))
        journal.write_message(
            values.clock_message(clock.current(), "start of the run" if previous is None else "the run is taken up again")
        )
        if self._replaced_start is not None:
            journal.write_text(
                clock.now_ns(), f"the log of an earlier start, which was refused, was replaced by this run: {self._replaced_start}"
            )
        await self._open_socket(stack, control, clock, journal)
        watcher = _watcher(control, clock, watch, journal)
        stack.callback(watcher.close)
        if self._config.sem.probe_share and (offset := probe_share(watch.folder, clock.now_ns)) is not None:
            journal.write_message(offset)
        complete = previous is not None and previous.interrupted_run.all_done(self._config.plan())
        links = {} if complete else self._links(control, clock, previous)
        try:
            identities = await self._open_devices(stack, control, clock, links, complete)
        except SemliveError as error:
            raise self._start_refused(control, error, previous) from error
        finish = await self._loop(control, clock, watcher, identities)
        texts = [control.failure or (f"{control.stop_reason}: {finish.text}" if control.stop_reason else finish.text)]
        unconfirmed = await loop.run_in_executor(None, _close_links, links)
        texts += unconfirmed
        watcher.close()
        if not await self._drain_analysis(control, analysis, stopped=finish.outcome is not State.COMPLETE):
            texts.append(f"the last pairs are not analysed; semlive replay {self._folder} does it")
        texts += control.unusable_pairs
        for text in texts[1:]:
            code = FaultCode.STOP_NOT_OBEYED if text in unconfirmed else ""
            control.trouble(text, "end of the run", "told the operator", code)
        self._log_ended = True
        if not await loop.run_in_executor(None, recorder.close, _LOG_TIMEOUT_S, _LOG_REFUSED_S):
            raise SemliveError(
                f"{recorder.part}: the log could not be finished ({recorder.backlog_message or 'the disk takes too long'}); "
                f"what was written is in it; not confirmed by the disk: {recorder.unacknowledged}"
            )
        return RunOutcome(self._folder, finish.outcome is State.COMPLETE and len(texts) == 1 and not control.failure, "; ".join(texts))

    async def _open_socket(
        self, stack: contextlib.ExitStack, control: Control, clock: SystemClock | SimulatedClock, journal: RunLog
    ) -> None:
        """Open the control socket, and connect the prompts of drivers to it."""
        prompts = OperatorPrompts(drivers.operator_interfaces(), clock, lambda message: control.call_soon(journal.write_message, message))
        stack.callback(prompts.close)
        if self._interface.on_socket_open is not None:
            control_socket = ControlSocket(
                lambda command, origin: control.call_soon(control.operator, command, origin), prompts.answer, self._acknowledge
            )
            self._interface.on_socket_open(await control_socket.open())
            stack.callback(control_socket.close)

    async def _open_devices(
        self,
        stack: contextlib.ExitStack,
        control: Control,
        clock: SystemClock | SimulatedClock,
        links: Mapping[Device, DeviceLink],
        complete: bool,
    ) -> Mapping[Device, DeviceIdentity]:
        """Open trigger and links, and check the identities of the devices; nothing is ordered.

        Raises:
            SemliveError: a device does not answer, or cannot do what the plan orders.
        """
        trigger = None if complete else self._open_trigger(control, clock)
        if trigger is not None:
            stack.callback(trigger.close)
        stack.callback(_close_links, links)
        control.connect(links, trigger)
        identities = await self._open_links(links)
        require_attendance(identities, self._interface.attended)
        require_orders(links.get(Device.LOAD_FRAME), self._config.plan())
        return identities

    def _start_refused(self, control: Control, error: SemliveError, previous: PreviousSegments | None) -> SemliveError:
        """Write the `/fault` message of a start that was refused after devices were opened; the log is kept.

        Returns:
            The error to raise, with the place of the log where this start has a log of its own.
        """
        control.trouble(str(error), REFUSED_START, "refused the start; nothing was ordered", refusal_code(error))
        self._opened_devices = True
        return error if previous is not None else named_in(error, self._folder)

    @staticmethod
    async def _open_links(links: Mapping[Device, DeviceLink]) -> Mapping[Device, DeviceIdentity]:
        """Open all links concurrently; open links receive keep-alive signals meanwhile."""
        loop = asyncio.get_running_loop()
        opening = asyncio.gather(*(loop.run_in_executor(None, link.open, _OPEN_TIMEOUT_S) for link in links.values()))
        while not opening.done():
            for link in links.values():
                link.keep_alive()
            await asyncio.sleep(_TICK_S)
        return dict(zip(links, opening.result(), strict=True))

    async def _loop(
        self,
        control: Control,
        clock: SystemClock | SimulatedClock,
        watcher: FolderWatcher,
        identities: Mapping[Device, DeviceIdentity],
    ) -> FinishRun:
        started, watch_failed = False, False
        ready_in_s = _READY_TIMEOUT_S + _READY_TIMEOUT_PER_PAIR_S * control.pairs_done
        ready_by = time.monotonic() + ready_in_s
        while not control.finished.done():
            while not self._interface.commands.empty():
                request = self._interface.commands.get()
                control.operator(request) if isinstance(request, OperatorCommand) else self._acknowledge(None, request.by)
            if not started and control.analysis_ready.is_set():
                started = self._started = True
                self._supervisor.ready(f"run {self._config.run.name}")
                watcher.start()
                control.ready(identities.get(Device.LOAD_FRAME), identities.get(Device.STAGE))
            elif not started and time.monotonic() > ready_by:
                raise SemliveError(f"the analysis process was not ready within {ready_in_s:g} s; run again on an idle computer")
            if watcher.failed and not watch_failed:
                watch_failed = True
                control.handle(DeviceFault(clock.now_ns(), Device.SEM, "the export folder is not watched any more"))
            control.tick()
            if control.troubled.is_set() and self._interface.stop_on_fault:
                control.troubled.clear()
                control.operator(OperatorCommand.STOP)
            await asyncio.sleep(_TICK_S)
        return control.finished.result()

    async def _drain_analysis(self, control: Control, analysis: AnalysisProcess, stopped: bool) -> bool:
        """Wait for the analysis of the last pairs, until the operator cancels the wait by a signal."""
        closing = asyncio.get_running_loop().run_in_executor(None, analysis.drain, _ANALYSIS_QUIET_S, stopped)
        while not closing.done():
            control.tick()
            if self._skip_analysis:
                analysis.kill()
            await asyncio.sleep(_TICK_S)
        # The last messages of the analysis are ahead of this in the queue of the loop.
        await asyncio.sleep(0)
        return closing.result()

    def _running(self) -> Control:
        if self._control is None:
            raise RuntimeError("the run has not begun")
        return self._control

    def _previous_segments(self, stack: contextlib.ExitStack) -> PreviousSegments:
        """Lock the folder of an interrupted run and return the state in its log."""
        if self._folder.is_dir():
            stack.enter_context(run_lock(self._folder))
            repair_partial_segments(self._folder)
        return read_previous_segments(self._folder, self._config)

    def _open_clock(self, previous: PreviousSegments | None) -> SystemClock | SimulatedClock:
        clock = open_clock(self._config.run.clock_file, None if previous is None else previous.clock_line(boot_id()))
        if previous is not None and clock.now_ns() <= previous.last_log_time_ns:
            behind_s = (previous.last_log_time_ns - clock.now_ns()) / 1e9
            raise BadConfig(f"{self._folder}: the clock is {behind_s:.1f} s behind the end of the run's log; set it right, then resume")
        return clock

    def _open_log(
        self, stack: contextlib.ExitStack, clock: SystemClock | SimulatedClock, previous: PreviousSegments | None
    ) -> tuple[RunLog, Recorder]:
        if previous is None:
            self._make_folder(stack)
        else:
            # The last segment is repaired first; `previous` lists the damage.
            repair_partial_segments(self._folder)
        recorder = Recorder(
            segment_path(self._folder, self._config.run.name, 0 if previous is None else previous.segment),
            clock,
            self._disk_trouble,
            after_ns=0 if previous is None else previous.last_log_time_ns,
            segment_bytes=round(self._config.run.segment_gb * 1e9),
        )
        # There is no second wait for a disk that rejected writes at the end of the run.
        stack.callback(lambda: recorder.close(0.0 if self._log_ended else _LOG_TIMEOUT_S, _LOG_REFUSED_S))
        return RunLog(recorder, None if previous is None else previous.alarms), recorder

    def _make_folder(self, stack: contextlib.ExitStack) -> None:
        """Create the folder of a new run. Its path is locked first, because another process may hold the lock of a deleted folder there."""
        try:
            # A parent that is a file makes mkdir fail below.
            with contextlib.suppress(FileExistsError):
                self._folder.parent.mkdir(parents=True)
            stack.enter_context(only_one_at(self._folder))
            self._replaced_start = remove_refused_start(self._folder)
            self._folder.mkdir()
        except FileExistsError:
            raise BadConfig(
                f"{self._folder}: this run exists already; give run.name another name, or --resume to take it up again"
            ) from None
        except OSError as error:
            raise BadConfig(f"{self._folder}: cannot be created ({error.strerror}); correct run.folder") from error
        stack.push(self._remove_refused_folder)
        stack.enter_context(held_itself(self._folder))

    def _remove_refused_folder(self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None) -> None:
        """Remove the folder after bad input before a device was opened, so that the run can be started again after a correction."""
        if isinstance(error, BadInput) and not self._started and not self._opened_devices:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _disk_trouble(self, message: str) -> None:
        """Report a write error; called in the thread of the recorder."""
        if self._control is not None:
            self._control.call_soon(self._control.trouble, message, "log", "kept in memory and tried again", FaultCode.LOG)

    def _links(self, control: Control, clock: SystemClock | SimulatedClock, previous: PreviousSegments | None) -> dict[Device, DeviceLink]:
        frame, stage, plan = self._config.load_frame, self._config.stage, self._config.plan()
        links = {}
        if frame is not None:
            links[Device.LOAD_FRAME] = DeviceLink(
                Device.LOAD_FRAME,
                lambda: drivers.open_load_frame(frame.driver, frame.settings, clock),
                lambda event: control.call_soon(control.handle, event),
                clock=clock,
                limits=plan.limits,
                poll_s=frame.poll_s,
                recalled=None if previous is None else previous.interrupted_run.ordered,
            )
        if stage is not None:
            links[Device.STAGE] = DeviceLink(
                Device.STAGE,
                lambda: drivers.open_stage(stage.driver, stage.settings, clock),
                lambda event: control.call_soon(control.handle, event),
                clock=clock,
                limits=plan.limits,
                poll_s=stage.poll_s,
            )
        return links

    def _open_trigger(self, control: Control, clock: SystemClock | SimulatedClock) -> TriggerLink | None:
        trigger = self._config.sem.trigger
        if trigger is None:
            return None
        opened = drivers.open_trigger(trigger.driver, trigger.settings, clock)
        return TriggerLink(opened, lambda event: control.call_soon(control.handle, event), clock)

    def _run_message(self, clock: SystemClock | SimulatedClock, segment: int) -> RunMessage:
        return RunMessage(
            run=self._config.run.name,
            segment=segment,
            started_time_ns=clock.now_ns(),
            started_mono_ns=clock.mono_ns(),
            boot_id=boot_id(),
            host=socket.gethostname(),
            versions=self._versions,
            config=self._config.model_dump(mode="json"),
        )

    @contextlib.contextmanager
    def _signal_handlers(self) -> Iterator[None]:
        """Handle signals. First Ctrl-C or SIGTERM: stop and finish. Second: abort. After the end of the protocol: skip the analysis."""

        def on_signal(*_: object) -> None:
            self._signals += 1
            control, command = self._control, OperatorCommand.STOP if self._signals == 1 else OperatorCommand.ABORT
            if control is not None:
                self._skip_analysis = self._skip_analysis or control.finished.done()
                control.call_soon(control.operator, command)

        previous_handlers = {number: signal.signal(number, on_signal) for number in _STOP_SIGNALS}
        try:
            yield
        finally:
            for number, handler in previous_handlers.items():
                signal.signal(number, handler)


def _acknowledge(journal: RunLog, clock: SystemClock | SimulatedClock, alarm: str | None, by: str) -> bool:
    """Log the acknowledgement of an alarm, or of all (None); no device moves. Return whether any of them was unacknowledged."""
    messages = acknowledgements(journal.alarms, alarm, by, clock.now_ns())
    for message in messages:
        journal.write_message(message)
    return bool(messages)


def _log_loop_error(journal: RunLog, clock: SystemClock | SimulatedClock, context: dict[str, Any]) -> None:
    """Write an error that asyncio would print to the log instead of the terminal."""
    error = context.get("exception")
    trace = "".join(traceback.format_exception(error)) if isinstance(error, BaseException) else ""
    journal.write_text(clock.now_ns(), f"{trace}{context.get('message', '')}", "error")


def _watcher(control: Control, clock: SystemClock | SimulatedClock, watch: WatchSettings, journal: RunLog) -> FolderWatcher:
    watcher = FolderWatcher(
        watch,
        clock,
        lambda file: control.call_soon(journal.file, file),
        lambda rejected: control.call_soon(control.on_file_refused, rejected.name, rejected.reason),
        lambda what: control.call_soon(control.trouble, what, "export folder", "kept trying"),
        lambda what: control.call_soon(control.on_notice, what),
        lambda what: control.call_soon(_folder_replaced, control, clock, what),
    )
    control.accept_folder = watcher.accept
    return watcher


def _folder_replaced(control: Control, clock: SystemClock | SimulatedClock, message: str) -> None:
    """Pause the run because the export folder was replaced by another folder; the operator must resume."""
    control.trouble(message, "export folder", "paused the run; nothing is taken from this folder", FaultCode.EXPORT_FOLDER)
    control.handle(OperatorAction(clock.now_ns(), OperatorCommand.PAUSE, message))
    control.troubled.set()


def _analysis_trouble(control: Control, clock: SystemClock | SimulatedClock, message: str, lost: bool) -> None:
    control.trouble(message, "analysis", "stopped" if lost else "started another that catches up from the log")
    if lost:
        control.handle(DeviceFault(clock.now_ns(), Device.SEM, "the analysis process is lost, so frames cannot be judged"))


def _close_links(links: Mapping[Device, DeviceLink]) -> list[str]:
    """Stop all devices at once, then wait for each; return a message for each device without a confirmed stop."""
    for link in links.values():
        link.stop("the run is over")
    unconfirmed = [device for device, link in links.items() if not link.close()]
    return [
        f"the {device.words} did not confirm that it stopped: look at the machine, and press its emergency stop if it moves"
        for device in unconfirmed
    ]
