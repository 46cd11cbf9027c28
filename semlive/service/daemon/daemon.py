"""The daemon: start-up, event loop and shutdown. In every case the load frame is stopped and the log is finished.

Theory of operation
-------------------
`run_experiment` blocks until the run is over; everything runs in one loop in the calling thread. Resources are opened in this order and
closed in reverse, by one exit stack: signals, folder lock, log, control, analysis, socket, watcher, trigger and links. At the end of the
protocol the devices are stopped first, then the last pairs are analysed, then the log is ended.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity
from semlive.engine import Device, FinishRun, OperatorCommand, State, start
from semlive.errors import BadConfig, SemliveError
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import RunMessage
from semlive.service.alerts.sender import AlertSender
from semlive.service.alerts.targets import read_targets
from semlive.service.analysis.process import AnalysisProcess
from semlive.service.config.configuration import Config
from semlive.service.control.control import Control
from semlive.service.control.previous_segments import PreviousSegments
from semlive.service.control.socket import ControlSocket
from semlive.service.daemon.callbacks import (
    BoundedHandoff,
    OperatorPrompts,
    acknowledger,
    analysis_trouble,
    folder_watcher,
    loop_error_handler,
)
from semlive.service.daemon.devices import close_links, device_links, open_links, open_trigger, require_attendance, require_orders
from semlive.service.daemon.process_signals import StopSignals, SystemdNotifier
from semlive.service.daemon.protocol_loop import ProtocolLoop, drain_analysis
from semlive.service.daemon.refused_start import REFUSED_START, named_in, refusal_code
from semlive.service.daemon.run_folder import LOG_REFUSED_S, LOG_TIMEOUT_S, RunFolder
from semlive.service.daemon.run_interface import RunInterface, RunOutcome
from semlive.service.device_link import DeviceLink
from semlive.service.log.recording import Recorder
from semlive.service.log.run_log import RunLog
from semlive.service.runtime import drivers
from semlive.service.runtime.clock import SimulatedClock, SystemClock, boot_id
from semlive.service.runtime.versions import versions
from semlive.service.watch.clock_offsets import probe_share
from semlive.service.watch.watch_settings import WatchSettings


def run_experiment(config: Config, interface: RunInterface) -> RunOutcome:
    """Run an experiment from start-up to the finished log.

    Raises:
        BadInput: configuration, folder or socket are invalid; nothing was moved.
        SemliveError: the run could not be started or finished.
    """
    return asyncio.run(_Daemon(config, interface).run())


@dataclass(frozen=True, slots=True)
class _Run:
    """What all parts of a started run share.

    Attributes:
        control: control of the run.
        clock: experiment time.
        journal: the log of the run.
        recorder: writer of the log.
        watch: settings of the folder watcher.
        previous: state in the earlier segments of the run; None for a new run.
    """

    control: Control
    clock: SystemClock | SimulatedClock
    journal: RunLog
    recorder: Recorder
    watch: WatchSettings
    previous: PreviousSegments | None


class _Daemon:
    """One run, from start-up to the finished log."""

    def __init__(self, config: Config, interface: RunInterface) -> None:
        self._config, self._interface = config, interface
        self._folder = RunFolder(config, self._disk_trouble)
        self._versions = versions(("numpy", "scipy", "numba", "mcap"))
        self._supervisor = SystemdNotifier(os.environ)
        self._signals = StopSignals()
        self._has_begun = False

    async def run(self) -> RunOutcome:
        """Open clock, log and control, run the experiment, and close everything."""
        watch, alerts = self._config.watch_settings(), self._config.alerts
        targets = () if alerts is None else read_targets(alerts.file)
        if not watch.folder.is_dir():
            raise BadConfig(f"sem.folder {watch.folder}: no such folder; create it or correct the path")
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._signals.handled())
            watchdog = asyncio.create_task(self._supervisor.watchdog())
            stack.callback(watchdog.cancel)
            stack.callback(self._supervisor.stopping)
            previous = self._folder.previous_segments(stack) if self._interface.resume else None
            clock = self._folder.open_clock(previous)
            # A plan that violates its limits is rejected before anything is written.
            start(self._config.plan(), clock.now_ns(), interrupted_run=None if previous is None else previous.interrupted_run)
            watch = replace(watch, first_export=0 if previous is None else previous.exports)
            journal, recorder = self._folder.open_log(stack, clock, previous)
            control = self._signals.control = Control(
                self._config.plan(), clock, journal, self._interface.observe, previous, self._interface.auto_resume
            )
            stack.callback(control.close)
            if alerts is not None:
                sender = AlertSender(
                    targets, frozenset(alerts.events), self._config.run.name, partial(control.call_soon, control.monitor.on_notice)
                )
                stack.callback(sender.close)
                journal.subscribe(sender.on_message)
            asyncio.get_running_loop().set_exception_handler(loop_error_handler(control, journal, clock))
            if self._signals.count:  # received before control existed
                control.call_soon(control.operator.execute, OperatorCommand.STOP)
            try:
                return await self._experiment(stack, _Run(control, clock, journal, recorder, watch, previous))
            except SemliveError:
                raise
            except Exception as error:
                control.fail(error)
                raise SemliveError(control.monitor.failure or str(error)) from error

    async def _experiment(self, stack: contextlib.ExitStack, run: _Run) -> RunOutcome:
        """Run from the open log to the finished log; the stack closes in reverse order, devices first."""
        control, previous, acknowledge = run.control, run.previous, acknowledger(run.journal, run.clock)
        analysis = self._start_analysis(stack, run)
        self._log_start(run)
        await self._open_socket(stack, run, acknowledge)
        watcher = folder_watcher(control, run.clock, run.watch, run.journal)
        stack.callback(watcher.close)
        if self._config.sem.probe_share and (offset := probe_share(run.watch.folder, run.clock.now_ns)) is not None:
            run.journal.write_message(offset)
        complete = previous is not None and previous.interrupted_run.all_done(self._config.plan())
        links = {} if complete else device_links(self._config, control, run.clock, previous)
        try:
            identities = await self._open_devices(stack, run, links, complete)
        except SemliveError as error:
            raise self._start_refused(control, error, previous) from error
        loop = ProtocolLoop(
            control,
            run.clock,
            watcher,
            identities,
            self._interface.commands,
            acknowledge,
            self._interface.stop_on_fault,
            self._protocol_begins,
        )
        finish = await loop.run()
        # Of the protocol alone: the state changes while the devices are closed.
        failure, reason = control.monitor.failure, control.monitor.stop_reason
        text = failure or (f"{reason}: {finish.text}" if reason else finish.text)
        unconfirmed = await asyncio.get_running_loop().run_in_executor(None, close_links, links)
        watcher.close()
        analysed = not self._has_begun and previous is None  # it has no input, and its imports and kernels may take long
        if not analysed:
            analysed = await drain_analysis(control, analysis, finish.outcome is not State.COMPLETE, lambda: self._signals.skip_analysis)
        return await self._conclude(run, replace(finish, text=text), unconfirmed, analysed)

    def _start_analysis(self, stack: contextlib.ExitStack, run: _Run) -> AnalysisProcess:
        """Start the analysis process; it follows the log from its beginning."""
        control, previous = run.control, run.previous
        analysis = AnalysisProcess(
            self._folder.path,
            lambda: run.recorder.write_failed,
            BoundedHandoff(control.call_soon, control.analysis.on_output),
            analysis_trouble(control, run.clock),
            (0, 0) if previous is None else (previous.inputs, previous.outputs),
        )
        stack.callback(analysis.close, 5.0)
        stack.callback(self._kill_unused, analysis)
        run.journal.subscribe(analysis.notify_input)
        return analysis

    def _kill_unused(self, analysis: AnalysisProcess) -> None:
        """Do not wait for the analysis of a refused start: it has nothing to analyse, and its imports and kernels take seconds."""
        if not self._has_begun:
            analysis.kill()

    def _log_start(self, run: _Run) -> None:
        """Write the first messages of the segment."""
        previous, clock, journal = run.previous, run.clock, run.journal
        journal.write_message(self._run_message(clock, 0 if previous is None else previous.segment))
        if previous is not None:
            journal.write_message(previous.snapshot(clock.now_ns()))
        journal.write_message(values.clock_message(clock.current(), "start of the run" if previous is None else "the run is resumed"))
        if self._folder.replaced_start is not None:
            journal.write_text(
                clock.now_ns(), f"the log of an earlier start, which was refused, was replaced by this run: {self._folder.replaced_start}"
            )

    async def _open_socket(self, stack: contextlib.ExitStack, run: _Run, acknowledge: Callable[[str | None, str], bool]) -> None:
        """Open the control socket, and connect the prompts of drivers to it."""
        control, journal = run.control, run.journal
        prompts = OperatorPrompts(
            drivers.operator_interfaces(), run.clock, lambda message: control.call_soon(journal.write_message, message)
        )
        stack.callback(prompts.close)
        if self._interface.on_socket_open is not None:
            control_socket = ControlSocket(
                lambda command, origin: control.call_soon(control.operator.execute, command, origin), prompts.answer, acknowledge
            )
            self._interface.on_socket_open(await control_socket.open())
            stack.callback(control_socket.close)

    async def _open_devices(
        self, stack: contextlib.ExitStack, run: _Run, links: Mapping[Device, DeviceLink], complete: bool
    ) -> Mapping[Device, DeviceIdentity]:
        """Open trigger and links, and check the identities of the devices; nothing is ordered.

        Raises:
            SemliveError: a device does not answer, or cannot do what the plan orders.
        """
        trigger = None if complete else open_trigger(self._config, run.control, run.clock)
        if trigger is not None:
            stack.callback(trigger.close)
        stack.callback(close_links, links)
        run.control.connect(links, trigger)
        identities = await open_links(links)
        require_attendance(identities, self._interface.attended)
        require_orders(links.get(Device.LOAD_FRAME), self._config.plan())
        return identities

    def _start_refused(self, control: Control, error: SemliveError, previous: PreviousSegments | None) -> SemliveError:
        """Write the `/fault` message of a start that was refused after devices were opened; the log is kept.

        Returns:
            The error to raise, with the place of the log where this start has a log of its own.
        """
        control.monitor.trouble(str(error), REFUSED_START, "refused the start; nothing was ordered", refusal_code(error))
        self._folder.keep = True
        return error if previous is not None else named_in(error, self._folder.path)

    def _protocol_begins(self) -> None:
        self._folder.keep = self._has_begun = True
        self._supervisor.ready(f"run {self._config.run.name}")

    async def _conclude(self, run: _Run, finish: FinishRun, unconfirmed: list[str], analysed: bool) -> RunOutcome:
        """Log what went wrong at the end, end the log and return the outcome.

        Args:
            run: the run.
            finish: result of the protocol, with the reason of a stop in its text.
            unconfirmed: messages on devices without a confirmed stop.
            analysed: whether all pairs are analysed.

        Raises:
            SemliveError: the log could not be finished.
        """
        monitor, recorder = run.control.monitor, run.recorder
        texts = [finish.text, *unconfirmed]
        if not analysed:
            texts.append(f"the last pairs are not analysed; semlive replay {self._folder.path} does it")
        texts += monitor.unusable_pairs
        for text in texts[1:]:
            code = FaultCode.STOP_NOT_OBEYED if text in unconfirmed else ""
            monitor.trouble(text, "end of the run", "reported to the operator", code)
        self._folder.log_ended = True
        if not await asyncio.get_running_loop().run_in_executor(None, recorder.close, LOG_TIMEOUT_S, LOG_REFUSED_S):
            raise SemliveError(
                f"{recorder.part}: the log could not be finished ({recorder.backlog_message or 'the disk takes too long'}); "
                f"it holds what was written; not confirmed by the disk: {recorder.unacknowledged}"
            )
        complete = finish.outcome is State.COMPLETE and len(texts) == 1 and not monitor.failure
        return RunOutcome(self._folder.path, complete, "; ".join(texts))

    def _disk_trouble(self, message: str) -> None:
        """Report a write error; called in the thread of the recorder."""
        control = self._signals.control
        if control is not None:
            control.call_soon(control.monitor.trouble, message, "log", "kept in memory and tried again", FaultCode.LOG)

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
