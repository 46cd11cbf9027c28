"""Commands of the operator, the automatic start, and the pause while the log does not keep up.

Theory of operation
-------------------
All methods run in the loop of control and never block. A run starts and resumes only while the log keeps up, because no data may be
lost. The start, and a resume without confirmation, are repeated every second until the devices have sent a fresh reading.
"""

from __future__ import annotations

from collections.abc import Callable

from semlive.data.faults import FaultCode
from semlive.engine import OperatorAction, OperatorCommand, State, changed_since
from semlive.formats.log.messages import OperatorMessage
from semlive.ports import ClockSource
from semlive.service.control.run_engine import RunEngine
from semlive.service.control.run_monitor import RunMonitor
from semlive.service.log.run_log import RunLog

_RETRY_NS = 1_000_000_000


class OperatorCommands:
    """Commands of the operator to the engine, and those that semlive gives in the name of the operator.

    Args:
        engine: the engine of the run.
        monitor: warnings and the reason of a stop.
        journal: the log of the run.
        clock: experiment time and the monotonic clock.
        auto_resume: resume without confirmation by the operator.
    """

    def __init__(self, engine: RunEngine, monitor: RunMonitor, journal: RunLog, clock: ClockSource, auto_resume: bool) -> None:
        self._engine, self._monitor, self._journal, self._clock = engine, monitor, journal, clock
        self._auto_resume = auto_resume
        self._retry_mono_ns: int | None = None
        self._log_behind = False
        self.accept_folder: Callable[[], None] = lambda: None
        """Accepts an export folder that replaced the original one; without effect if there is none."""

    def execute(self, verb: OperatorCommand, by: str = "") -> None:
        """Log and handle a command of the operator; `by` is its origin, empty for the terminal."""
        now_ns = self._clock.now_ns()
        self._journal.write_message(OperatorMessage(time_ns=now_ns, what=verb, args={"by": by} if by else {}))
        if self._log_behind and verb in (OperatorCommand.START, OperatorCommand.RESUME):
            self._monitor.warn(f"cannot {verb}: the log does not keep up")
            return
        if verb in (OperatorCommand.START, OperatorCommand.RESUME):
            self.accept_folder()
        self._engine.handle(OperatorAction(now_ns, verb))

    def begin(self) -> None:
        """Start the run, or resume it without confirmation, as soon as the engine accepts that."""
        self._retry_mono_ns = self._clock.mono_ns()
        self.retry_start()

    def retry_start(self) -> None:
        """Repeat a start, or an automatic resume, that was rejected because there was no fresh reading."""
        retry_mono_ns = self._retry_mono_ns
        if retry_mono_ns is None or self._clock.mono_ns() < retry_mono_ns:
            return
        self._retry_mono_ns = self._clock.mono_ns() + _RETRY_NS
        if self._log_behind:
            return
        state = self._engine.state.state
        if state is State.READY:
            self.execute(OperatorCommand.START)
        elif state is State.RESUMING and self._auto_resume:
            self._resume_without_confirmation()
        else:
            self._retry_mono_ns = None

    def _resume_without_confirmation(self) -> None:
        """Resume without confirmation; if the devices differ from the log, report a fault and wait for the operator."""
        change, monitor = changed_since(self._engine.state), self._monitor
        if change is None:
            self.execute(OperatorCommand.RESUME)
            return
        self._retry_mono_ns = None
        monitor.stop_reason = f"the run is not resumed by itself, because {change.reason}"
        monitor.trouble(monitor.stop_reason, "protocol", "ordered nothing; resume when you have looked at the machine", change.code)
        monitor.troubled.set()

    def check_log(self, backlog: str | None) -> None:
        """Pause the run while the log does not keep up, so that no data are lost; only the operator resumes it.

        Args:
            backlog: message on the backlog of the recorder; None while the log keeps up.
        """
        if (backlog is not None) == self._log_behind:
            return
        self._log_behind = backlog is not None
        if backlog is not None:
            self._monitor.trouble(backlog, "log", "paused the run; messages are kept in memory meanwhile", FaultCode.LOG)
            self._engine.handle(OperatorAction(self._clock.now_ns(), OperatorCommand.PAUSE, backlog))
            self._monitor.troubled.set()
        else:
            self._journal.write_text(self._clock.now_ns(), "the log keeps up again; resume when you are ready")
            self._monitor.warn("the log keeps up again; resume when you are ready")
