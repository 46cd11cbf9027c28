"""The states of a run while its log grows, each message read once: reading the complete log every 10 ms occupies a processor."""

from __future__ import annotations

import json
from pathlib import Path

from semlive.service.log.tail import LogReplaced, LogTail


class StatesOf:
    """Follower of the log of a run.

    Args:
        log: run folder, which need not exist yet.
    """

    def __init__(self, log: Path) -> None:
        self._log, self._tail = log, LogTail(log)
        self._states: list[str] = []

    def so_far(self) -> list[str]:
        """All states that the run has entered, in order; those of the present log if another one was replaced by it."""
        try:
            self._states += [json.loads(item.payload)["after"] for item in self._tail.poll() if item.topic == "/state"]
        except LogReplaced:
            self._tail, self._states = LogTail(self._log), []
        return self._states
