"""What display and final message show of a run: warnings, the reason of a stop, unusable pairs, and the newest results.

Theory of operation
-------------------
All methods run in the loop of control and never block. Faults of semlive itself, and unusual observations, are written to the log here and
become warnings at the same time, so the display and the log cannot differ.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from semlive.engine import EngineState, RunStatus, progress
from semlive.formats.log.messages import ElasticMessage
from semlive.ports import ClockSource
from semlive.service.log.alarms import Alarm
from semlive.service.log.run_log import RunLog

_MAX_WARNINGS = 50
"""Number of warnings that a snapshot holds."""


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


class RunMonitor:
    """Warnings, faults and newest results of a run.

    Args:
        journal: the log of the run.
        clock: experiment time.
        pairs_analysed: pairs whose result is in the earlier segments of the log.
    """

    def __init__(self, journal: RunLog, clock: ClockSource, pairs_analysed: int) -> None:
        self._journal, self._clock = journal, clock
        self._warnings: tuple[str, ...] = ()
        self.pairs_analysed = pairs_analysed
        self.drift_rate_px_s: tuple[float, float] | None = None
        self.elastic: ElasticMessage | None = None
        self.stop_reason: str | None = None
        """Reason of the present fault, or of the open question of the calibration gate; None while the run continues."""
        self.failure: str | None = None
        """Error of semlive itself that ended the run."""
        self.unusable_pairs: tuple[str, ...] = ()
        """Messages on pairs that were found unusable after the last step."""
        self.troubled = asyncio.Event()
        """Set when the operator has to decide."""

    def warn(self, text: str) -> None:
        """Add a warning to the snapshots."""
        self._warnings = (*self._warnings, text)[-_MAX_WARNINGS:]

    def trouble(self, what: str, where: str, action: str, code: str = "") -> None:
        """Log a fault of semlive itself; `code` is a `FaultCode`."""
        self._journal.fault(self._clock.now_ns(), what, where, action, code)
        self.warn(what)

    def on_file_refused(self, name: str, reason: str) -> None:
        """Log a file that the folder watcher rejected."""
        self._journal.refused_file(None, name, reason, self._clock.now_ns())
        self.warn(reason)

    def on_notice(self, what: str) -> None:
        """Log an unusual observation of the folder watcher that is not a fault."""
        self._journal.write_text(self._clock.now_ns(), what, "warning")
        self.warn(what)

    def snapshot(self, state: EngineState) -> RunSnapshot:
        """Return the snapshot for display."""
        now_ns = self._clock.now_ns()
        alarms, rate = self._journal.alarms.listed, self.drift_rate_px_s
        return RunSnapshot(now_ns, progress(state), rate, self.elastic, self.pairs_analysed, self._warnings, alarms)
