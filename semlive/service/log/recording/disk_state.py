"""Problems of the disk that the recorder has observed."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from semlive.service.log.recording.message_queue import Backlog
from semlive.service.log.recording.unacknowledged import remedy

# Time after a failed fsync during which the log is reported as behind, so that the run is paused.
_SUSPECT_S = 2.0


@dataclass(slots=True)
class DiskState:
    """Problems of the disk; the recorder thread writes it, all threads read it.

    Attributes:
        refused: reason why the disk rejects writes; empty while it accepts them.
        remedy: what the operator should do about it, an imperative clause.
        suspect_until_s: monotonic time until which a failed fsync is reported.
        moved: another program has moved or removed the growing file.
        truncated: another program has truncated the growing file.
    """

    refused: str = ""
    remedy: str = ""
    suspect_until_s: float = 0.0
    moved: bool = False
    truncated: bool = False

    def refuse(self, error: OSError) -> None:
        """Note that the disk rejects writes."""
        self.refused, self.remedy = str(error.strerror or error), remedy(error)

    def suspect(self) -> None:
        """Note a failed fsync."""
        self.suspect_until_s = time.monotonic() + _SUSPECT_S

    @property
    def write_failed(self) -> bool:
        """Whether written data do not reach the disk, or not the file that readers open."""
        return bool(self.refused) or self.moved or self.truncated

    def message(self, part: Path, backlog: Backlog, slow_after_s: float) -> str | None:
        """Return why new messages will not be on the disk soon, a clause; None while the log keeps up.

        Args:
            part: the growing file.
            backlog: messages that are not written yet.
            slow_after_s: wall seconds after which unwritten messages mean that the disk is too slow.
        """
        if self.refused:
            return f"the log cannot be written ({self.refused}): {self.remedy}"
        if time.monotonic() < self.suspect_until_s:
            return f"{part}: the disk failed to confirm what was written: check the disk before you resume"
        if self.moved or self.truncated:
            done, advice = ("cut short", "stop the run") if self.truncated else ("moved or removed", "put it back, or stop the run")
            return f"{part}: another program has {done} the log while it is written: keep it away from there and {advice}"
        if backlog.waits_s > slow_after_s or backlog.is_large:
            return f"the disk is too slow: {backlog.messages} messages wait for {backlog.waits_s:.0f} s to be written to the log"
        return None
