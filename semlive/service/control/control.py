"""Control: the loop of a run. It joins engine, devices, analysis and operator, and ends the run after an unexpected exception.

Theory of operation
-------------------
Control runs in one asyncio loop and never blocks it. Device calls, file reading, correlation and writing run in separate threads or
processes, which return their results through `Control.call_soon`. The parts of control call each other directly, in the loop:

    operator, socket  -> OperatorCommands --+
    analysis          -> AnalysisReceiver --+-> RunEngine.handle -> CommandDispatcher -> DeviceLink, TriggerLink
    links, folder     ----------------------+        |
                                                  RunMonitor -> display

The log is written by each part before it acts, so the log determines the state of the run.
"""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections.abc import Callable, Mapping
from typing import ParamSpec

from semlive.data.experiment import Plan
from semlive.data.loading import DeviceIdentity
from semlive.engine import Device, FinishRun, LinkLost, LinksOpening, LinksReady, OperatorAction, OperatorCommand, State, Tick, start
from semlive.errors import SemliveError
from semlive.formats.log import conversions as values
from semlive.service.control.analysis_receiver import AnalysisReceiver
from semlive.service.control.command_dispatcher import CommandDispatcher
from semlive.service.control.operator_commands import OperatorCommands
from semlive.service.control.previous_segments import PreviousSegments
from semlive.service.control.run_engine import RunEngine
from semlive.service.control.run_monitor import RunMonitor, RunSnapshot
from semlive.service.device_link import DeviceLink
from semlive.service.device_link.trigger import TriggerLink
from semlive.service.log.run_log import RunLog
from semlive.service.runtime.clock import SimulatedClock, SystemClock

P = ParamSpec("P")

_BLOCKED_S = 4.0
"""A driver call that takes longer will not return: the timeouts of drivers are tenths of a second."""


class Control:
    """The parts of a run and their loop; one object per loop."""

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
        self._blocked: set[Device] = set()
        self._clock_revision = clock.current().revision
        self._closed = False
        self.pairs_done = 0 if previous is None else len(previous.interrupted_run.completed_pairs)
        self.monitor = RunMonitor(journal, clock, 0 if previous is None else previous.pairs_analysed)
        self.dispatcher = CommandDispatcher(journal, clock)
        state = start(plan, clock.now_ns(), interrupted_run=None if previous is None else previous.interrupted_run)
        self.engine = RunEngine(state, clock, journal, self.dispatcher, self.monitor)
        self.operator = OperatorCommands(self.engine, self.monitor, journal, clock, auto_resume)
        self.analysis = AnalysisReceiver(self.engine, self.monitor, journal, clock)

    def connect(self, links: Mapping[Device, DeviceLink], trigger: TriggerLink | None) -> None:
        """Set the links and the trigger that execute commands."""
        self.dispatcher.connect(links, trigger)
        self.engine.handle(LinksOpening(self._clock.now_ns()))

    def ready(self, load_frame: DeviceIdentity | None, stage: DeviceIdentity | None) -> None:
        """Begin the protocol: all links are open and the analysis is ready."""
        now_ns = self._clock.now_ns()
        self.engine.handle(LinksReady(now_ns, load_frame, stage))
        self.operator.begin()

    def tick(self) -> None:
        """Send keep-alive signals to the links, check clock and log, and pass a Tick to the engine."""
        self._guarded(self._tick)

    def _tick(self) -> None:
        for device, link in self.dispatcher.links.items():
            link.keep_alive()
            self._check_link(device, link)
        clock = self._clock.current()
        if clock.revision != self._clock_revision:
            self._clock_revision = clock.revision
            self._journal.write_message(values.clock_message(clock, "the simulation fell behind and stretched its clock"))
        self.operator.check_log(self._journal.recorder.backlog_message)
        self.engine.handle(Tick(self._clock.now_ns()))
        self.operator.retry_start()
        self._observe(self.monitor.snapshot(self.engine.state))

    def _check_link(self, device: Device, link: DeviceLink) -> None:
        """Report a link thread that is blocked in its driver: it can neither report this nor stop the device."""
        if link.blocked_s < _BLOCKED_S:
            self._blocked.discard(device)
        elif device not in self._blocked:
            self._blocked.add(device)
            reason = f"its driver has not come back for {_BLOCKED_S:g} s, so it cannot be ordered to stop: stop the machine by hand"
            self.engine.handle(LinkLost(self._clock.now_ns(), device, reason))

    def call_soon(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Call a function in the loop; for use by other threads. An exception in the call ends the run."""
        self._loop.call_soon_threadsafe(lambda: None if self._closed else self._guarded(call, *args, **kwargs))

    def _guarded(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Call a function and end the run after an exception, which asyncio would only print."""
        try:
            call(*args, **kwargs)
        except Exception as error:
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """Stop all devices, log the error and end the run: after an unexpected exception the state may be wrong."""
        self.dispatcher.stop_all("semlive itself failed")
        if self.monitor.failure is None:
            expected = isinstance(error, SemliveError)
            message = " ".join(str(error).split()) or type(error).__name__
            failure = message if expected else f"semlive itself failed ({type(error).__name__}: {message}); the log holds the traceback"
            self.monitor.failure = failure
            trace = "".join(traceback.format_exception(error))
            # Writing the log may be the cause of the failure.
            with contextlib.suppress(Exception):
                self.monitor.trouble(failure, "control", "stopped everything and ended the run")
                self._journal.write_text(self._clock.now_ns(), trace, "error")
            with contextlib.suppress(Exception):
                self.engine.handle(OperatorAction(self._clock.now_ns(), OperatorCommand.ABORT))
        if not self.dispatcher.finished.done():
            self.dispatcher.finished.set_result(FinishRun(State.ABORTED, self.monitor.failure))

    def close(self) -> None:
        """Ignore all later calls, because the log is being closed."""
        self._closed = True
