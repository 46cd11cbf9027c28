"""The daemon: start-up, the loop, shutdown. Whatever happens, the frame is stopped and the log is finished."""

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
from semlive.service.log.recorder import Recorder
from semlive.service.log.repair import repair_partial_segments
from semlive.service.log.run_log import RunLog
from semlive.service.runtime import drivers
from semlive.service.runtime.clock import SimulatedClock, SystemClock, open_clock
from semlive.service.runtime.process import boot_id
from semlive.service.runtime.versions import versions
from semlive.service.watch.clock_offsets import probe_share
from semlive.service.watch.thread import FolderWatcher, WatchSettings

_TICK_S = 0.05
_OPEN_TIMEOUT_S = 10.0
_LOG_TIMEOUT_S = 10.0
# A disk that still refuses when the run ends is not waited for as long as one that is slow.
_LOG_REFUSED_S = 3.0
# Pairs may still wait for their analysis when the protocol ends, so it has the time it needs while results keep coming. Between
# two of them lie seconds, or what a new child needs to catch up; the conclusion of 22 pairs took two minutes on a busy computer.
_ANALYSIS_QUIET_S = 300.0
# Compiling for the first time takes half a minute on 2 cores.
_READY_TIMEOUT_S = 300.0
# A run that is taken up again has its pairs correlated anew first: at 16 million pixels a pair takes some seconds.
_READY_TIMEOUT_PER_PAIR_S = 20.0
# SIGHUP: the terminal was closed; SIGBREAK: likewise, and Ctrl-Break, on Windows.
_STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How a run ended.

    Attributes:
        log: run folder.
        complete: every step was done.
        text: one sentence.
    """

    log: Path
    complete: bool
    text: str


@dataclass(frozen=True, slots=True)
class RunInterface:
    """Who looks at a run and speaks to it.

    Attributes:
        observe: gets a snapshot with every tick, in the loop; must not block.
        commands: what the operator says, from any thread.
        attended: somebody stays at the instrument.
        stop_on_fault: end the run at a fault instead of waiting for the operator.
        resume: take up a run that was interrupted, instead of beginning one.
        auto_resume: the answer to what a run that is taken up again asks, given beforehand; holds only if the devices are as the log
            left them.
        on_socket_open: told where other processes of this computer may speak to the run, when they may; in the loop, must not block.
    """

    observe: Callable[[RunSnapshot], None]
    commands: queue.SimpleQueue[OperatorCommand | AcknowledgeAll]
    attended: bool = False
    stop_on_fault: bool = False
    resume: bool = False
    auto_resume: bool = False
    on_socket_open: Callable[[SocketAddress], object] | None = None


def run_experiment(config: Config, faces: RunInterface) -> RunOutcome:
    """Run an experiment from start-up to the finished log.

    Raises:
        BadInput: configuration, folder or socket are not as they must be; nothing was moved.
        SemliveError: the run could not be started or finished.
    """
    return asyncio.run(_Daemon(config, faces).run())


class _Daemon:
    def __init__(self, config: Config, faces: RunInterface) -> None:
        self._config, self._faces = config, faces
        self._folder = config.run.folder / config.run.name
        self._versions = versions(("numpy", "scipy", "numba", "mcap"))
        self._supervisor = SystemdNotifier(os.environ)
        self._signals = 0
        self._impatient = False
        self._log_ended = False
        self._control: Control | None = None
        self._began = False
        self._opened_devices = False
        self._replaced: str | None = None
        self._acknowledge: Callable[[str | None, str], bool] = lambda *_: False

    async def run(self) -> RunOutcome:
        watch = self._config.watch_settings()
        if not watch.folder.is_dir():
            raise BadConfig(f"sem.folder {watch.folder}: no such folder; create it or correct the path")
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._signals_heard())
            beating = asyncio.create_task(self._supervisor.watchdog())
            stack.callback(beating.cancel)
            stack.callback(self._supervisor.stopping)
            earlier = self._earlier(stack) if self._faces.resume else None
            clock = self._open_clock(earlier)
            # A plan that breaks its limits is refused before anything is written.
            start(self._config.plan(), clock.now_ns(), interrupted_run=None if earlier is None else earlier.interrupted_run)
            watch = replace(watch, first_export=0 if earlier is None else earlier.exports)
            journal, recorder = self._open_log(stack, clock, earlier)
            self._control = control = Control(self._config.plan(), clock, journal, self._faces.observe, earlier, self._faces.auto_resume)
            stack.callback(control.close)
            asyncio.get_running_loop().set_exception_handler(lambda _, told: control.call_soon(_unexpected, journal, clock, told))
            if self._signals:  # heard while there was nobody yet to carry it out
                control.call_soon(control.operator, OperatorCommand.STOP)
            try:
                return await self._experiment(stack, clock, watch, journal, recorder, earlier)
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
        earlier: PreviousSegments | None,
    ) -> RunOutcome:
        """From the open log to the finished one; the stack undoes in reverse, devices first."""
        control, loop = self._running(), asyncio.get_running_loop()
        self._acknowledge = partial(_acknowledge, journal, clock)
        analysis = AnalysisProcess(
            self._folder,
            lambda: recorder.write_failed,
            BoundedHandoff(control.call_soon, control.on_analysis_output),
            lambda what, lost: control.call_soon(_analysis_trouble, control, clock, what, lost),
            (0, 0) if earlier is None else (earlier.inputs, earlier.outputs),
        )
        stack.callback(analysis.close, 5.0)
        journal.subscribe(analysis.notify_input)
        journal.write_message(self._run_message(clock, 0 if earlier is None else earlier.segment))
        if earlier is not None:
            journal.write_message(earlier.snapshot(clock.now_ns()))
        journal.write_message(values.clock_message(clock.current(), "start of the run" if earlier is None else "the run is taken up again"))
        if self._replaced is not None:
            journal.write_text(
                clock.now_ns(), f"the log of an earlier start, which was refused, was replaced by this run: {self._replaced}"
            )
        await self._open_door(stack, control, clock, journal)
        watcher = _watcher(control, clock, watch, journal)
        stack.callback(watcher.close)
        if self._config.sem.probe_share and (offset := probe_share(watch.folder, clock.now_ns)) is not None:
            journal.write_message(offset)
        over = earlier is not None and earlier.interrupted_run.all_done(self._config.plan())
        links = {} if over else self._links(control, clock, earlier)
        try:
            identities = await self._open_devices(stack, control, clock, links, over)
        except SemliveError as error:
            raise self._start_refused(control, error, earlier) from error
        finish = await self._loop(control, clock, watcher, identities)
        texts = [control.failure or (f"{control.stop_reason}: {finish.text}" if control.stop_reason else finish.text)]
        unsure = await loop.run_in_executor(None, _close_links, links)
        texts += unsure
        watcher.close()
        if not await self._analysed(control, analysis, stopped=finish.outcome is not State.COMPLETE):
            texts.append(f"the last pairs are not analysed; semlive replay {self._folder} does it")
        texts += control.unusable_pairs
        for text in texts[1:]:
            code = FaultCode.STOP_NOT_OBEYED if text in unsure else ""
            control.trouble(text, "end of the run", "told the operator", code)
        self._log_ended = True
        if not await loop.run_in_executor(None, recorder.close, _LOG_TIMEOUT_S, _LOG_REFUSED_S):
            raise SemliveError(
                f"{recorder.part}: the log could not be finished ({recorder.backlog_message or 'the disk takes too long'}); "
                f"what was written is in it; not confirmed by the disk: {recorder.unacknowledged}"
            )
        return RunOutcome(self._folder, finish.outcome is State.COMPLETE and len(texts) == 1 and not control.failure, "; ".join(texts))

    async def _open_door(self, stack: contextlib.ExitStack, control: Control, clock: SystemClock | SimulatedClock, journal: RunLog) -> None:
        """Let other processes speak to the run, and answer what drivers ask a person."""
        desks = OperatorPrompts(drivers.operator_interfaces(), clock, lambda told: control.call_soon(journal.write_message, told))
        stack.callback(desks.close)
        if self._faces.on_socket_open is not None:
            door = ControlSocket(lambda verb, by: control.call_soon(control.operator, verb, by), desks.answer, self._acknowledge)
            self._faces.on_socket_open(await door.open())
            stack.callback(door.close)

    async def _open_devices(
        self,
        stack: contextlib.ExitStack,
        control: Control,
        clock: SystemClock | SimulatedClock,
        links: Mapping[Device, DeviceLink],
        over: bool,
    ) -> Mapping[Device, DeviceIdentity]:
        """Open trigger and links, and check what answers; nothing is ordered.

        Raises:
            SemliveError: a device does not answer, or cannot do what the plan orders.
        """
        trigger = None if over else self._open_trigger(control, clock)
        if trigger is not None:
            stack.callback(trigger.close)
        stack.callback(_close_links, links)
        control.connect(links, trigger)
        identities = await self._open_links(links)
        require_attendance(identities, self._faces.attended)
        require_orders(links.get(Device.LOAD_FRAME), self._config.plan())
        return identities

    def _start_refused(self, control: Control, error: SemliveError, earlier: PreviousSegments | None) -> SemliveError:
        """Write the `/fault` message of a start that was refused after devices were opened; the log is kept.

        Returns:
            The error to raise, with the place of the log where this start has a log of its own.
        """
        control.trouble(str(error), REFUSED_START, "refused the start; nothing was ordered", refusal_code(error))
        self._opened_devices = True
        return error if earlier is not None else named_in(error, self._folder)

    @staticmethod
    async def _open_links(links: Mapping[Device, DeviceLink]) -> Mapping[Device, DeviceIdentity]:
        """Open them all at once, and keep feeding those that are open already."""
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
        started, deaf = False, False
        ready_in_s = _READY_TIMEOUT_S + _READY_TIMEOUT_PER_PAIR_S * control.pairs_done
        ready_by = time.monotonic() + ready_in_s
        while not control.finished.done():
            while not self._faces.commands.empty():
                said = self._faces.commands.get()
                control.operator(said) if isinstance(said, OperatorCommand) else self._acknowledge(None, said.by)
            if not started and control.analysis_ready.is_set():
                started = self._began = True
                self._supervisor.ready(f"run {self._config.run.name}")
                watcher.start()
                control.ready(identities.get(Device.LOAD_FRAME), identities.get(Device.STAGE))
            elif not started and time.monotonic() > ready_by:
                raise SemliveError(f"the analysis process was not ready within {ready_in_s:g} s; run again on an idle computer")
            if watcher.failed and not deaf:
                deaf = True
                control.handle(DeviceFault(clock.now_ns(), Device.SEM, "the export folder is not watched any more"))
            control.tick()
            if control.troubled.is_set() and self._faces.stop_on_fault:
                control.troubled.clear()
                control.operator(OperatorCommand.STOP)
            await asyncio.sleep(_TICK_S)
        return control.finished.result()

    async def _analysed(self, control: Control, analysis: AnalysisProcess, stopped: bool) -> bool:
        """Wait for the last pairs, but not longer than the operator does."""
        closing = asyncio.get_running_loop().run_in_executor(None, analysis.drain, _ANALYSIS_QUIET_S, stopped)
        while not closing.done():
            control.tick()
            if self._impatient:
                analysis.kill()
            await asyncio.sleep(_TICK_S)
        # What it said last is in the loop's queue ahead of this.
        await asyncio.sleep(0)
        return closing.result()

    def _running(self) -> Control:
        if self._control is None:
            raise RuntimeError("the run has not begun")
        return self._control

    def _earlier(self, stack: contextlib.ExitStack) -> PreviousSegments:
        """What an interrupted run left behind, which is ours from now on."""
        if self._folder.is_dir():
            stack.enter_context(run_lock(self._folder))
            repair_partial_segments(self._folder)
        return read_previous_segments(self._folder, self._config)

    def _open_clock(self, earlier: PreviousSegments | None) -> SystemClock | SimulatedClock:
        clock = open_clock(self._config.run.clock_file, None if earlier is None else earlier.clock_line(boot_id()))
        if earlier is not None and clock.now_ns() <= earlier.last_log_time_ns:
            behind_s = (earlier.last_log_time_ns - clock.now_ns()) / 1e9
            raise BadConfig(f"{self._folder}: the clock is {behind_s:.1f} s behind the end of the run's log; set it right, then resume")
        return clock

    def _open_log(
        self, stack: contextlib.ExitStack, clock: SystemClock | SimulatedClock, earlier: PreviousSegments | None
    ) -> tuple[RunLog, Recorder]:
        if earlier is None:
            self._make_folder(stack)
        else:
            # What the run was when it broke off is finished first; `earlier` tells what was lost of it.
            repair_partial_segments(self._folder)
        recorder = Recorder(
            segment_path(self._folder, self._config.run.name, 0 if earlier is None else earlier.segment),
            clock,
            self._disk_trouble,
            after_ns=0 if earlier is None else earlier.last_log_time_ns,
            segment_bytes=round(self._config.run.segment_gb * 1e9),
        )
        # A disk that still refused when the run ended is not waited for a second time.
        stack.callback(lambda: recorder.close(0.0 if self._log_ended else _LOG_TIMEOUT_S, _LOG_REFUSED_S))
        return RunLog(recorder, None if earlier is None else earlier.alarms), recorder

    def _make_folder(self, stack: contextlib.ExitStack) -> None:
        """A new run's folder, held by us from before it is made: its place may still be another's whose folder was deleted."""
        try:
            # A parent that is a file makes mkdir fail below.
            with contextlib.suppress(FileExistsError):
                self._folder.parent.mkdir(parents=True)
            stack.enter_context(only_one_at(self._folder))
            self._replaced = remove_refused_start(self._folder)
            self._folder.mkdir()
        except FileExistsError:
            raise BadConfig(
                f"{self._folder}: this run exists already; give run.name another name, or --resume to take it up again"
            ) from None
        except OSError as error:
            raise BadConfig(f"{self._folder}: cannot be created ({error.strerror}); correct run.folder") from error
        stack.push(self._forget_what_was_refused)
        stack.enter_context(held_itself(self._folder))

    def _forget_what_was_refused(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """Bad input before a device was opened leaves no run behind, so that the same run can be started once it is mended."""
        if isinstance(error, BadInput) and not self._began and not self._opened_devices:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _disk_trouble(self, what: str) -> None:
        """In the recorder's thread."""
        if self._control is not None:
            self._control.call_soon(self._control.trouble, what, "log", "kept in memory and tried again", FaultCode.LOG)

    def _links(self, control: Control, clock: SystemClock | SimulatedClock, earlier: PreviousSegments | None) -> dict[Device, DeviceLink]:
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
                recalled=None if earlier is None else earlier.interrupted_run.ordered,
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
    def _signals_heard(self) -> Iterator[None]:
        """First Ctrl-C or SIGTERM: stop and finish. Second: abort. One after the protocol has ended: do not wait for analysis."""

        def asked(*_: object) -> None:
            self._signals += 1
            control, verb = self._control, OperatorCommand.STOP if self._signals == 1 else OperatorCommand.ABORT
            if control is not None:
                self._impatient = self._impatient or control.finished.done()
                control.call_soon(control.operator, verb)

        before = {number: signal.signal(number, asked) for number in _STOP_SIGNALS}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def _acknowledge(journal: RunLog, clock: SystemClock | SimulatedClock, alarm: str | None, by: str) -> bool:
    """The operator has read an alarm, or all of them (None): it is written down, and nothing moves; says whether any was open."""
    messages = acknowledgements(journal.alarms, alarm, by, clock.now_ns())
    for message in messages:
        journal.write_message(message)
    return bool(messages)


def _unexpected(journal: RunLog, clock: SystemClock | SimulatedClock, told: dict[str, Any]) -> None:
    """What asyncio would print goes into the log: a terminal is for sentences that say what to do."""
    error = told.get("exception")
    trace = "".join(traceback.format_exception(error)) if isinstance(error, BaseException) else ""
    journal.write_text(clock.now_ns(), f"{trace}{told.get('message', '')}", "error")


def _watcher(control: Control, clock: SystemClock | SimulatedClock, watch: WatchSettings, journal: RunLog) -> FolderWatcher:
    watcher = FolderWatcher(
        watch,
        clock,
        lambda file: control.call_soon(journal.file, file),
        lambda refused: control.call_soon(control.on_file_refused, refused.name, refused.reason),
        lambda what: control.call_soon(control.trouble, what, "export folder", "kept trying"),
        lambda what: control.call_soon(control.on_notice, what),
        lambda what: control.call_soon(_folder_replaced, control, clock, what),
    )
    control.accept_folder = watcher.accept
    return watcher


def _folder_replaced(control: Control, clock: SystemClock | SimulatedClock, what: str) -> None:
    """Another folder stands in the place of the export folder: the run pauses until the operator resumes."""
    control.trouble(what, "export folder", "paused the run; nothing is taken from this folder", FaultCode.EXPORT_FOLDER)
    control.handle(OperatorAction(clock.now_ns(), OperatorCommand.PAUSE, what))
    control.troubled.set()


def _analysis_trouble(control: Control, clock: SystemClock | SimulatedClock, what: str, lost: bool) -> None:
    control.trouble(what, "analysis", "stopped" if lost else "started another that catches up from the log")
    if lost:
        control.handle(DeviceFault(clock.now_ns(), Device.SEM, "the analysis process is lost, so frames cannot be judged"))


def _close_links(links: Mapping[Device, DeviceLink]) -> list[str]:
    """Stop all devices at once, then wait for each; says which one did not confirm."""
    for link in links.values():
        link.stop("the run is over")
    unsure = [device for device, link in links.items() if not link.close()]
    return [
        f"the {device.words} did not confirm that it stopped: look at the machine, and press its emergency stop if it moves"
        for device in unsure
    ]
