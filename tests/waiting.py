"""Waiting for processes: one upper bound for all tests, and the messages of a log that grows.

A wait ends by what is observed. Its upper bound is reached only by an error, so it is generous: a busy computer needs a minute for what
takes two seconds on an idle one. A shorter bound belongs only to a promise of the product, such as the time to a stop.
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from semlive.service.log.files import messages
from semlive.service.log.tail import LogReplaced, LogTail

PATIENCE_S = 150.0
"""Upper bound of a wait, s."""
RUN_END_S = 900.0
"""Upper bound of a run of the daemon to its end, s; two of them are shorter than the limit of a test."""


def wait_until(condition: Callable[[], object], within_s: float = PATIENCE_S) -> float:
    """Wait for a condition; returns the time at which it was observed, monotonic s.

    Raises:
        AssertionError: the condition is not fulfilled within the bound.
    """
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s, f"it did not come to that within {within_s:g} s"
        time.sleep(0.01)
    return time.monotonic()


def logged(log: Path, topic: str) -> list[dict[str, Any]]:
    """Messages of a topic in a log, growing or finished; none before the first segment exists."""
    exists = log.is_file() or any(log.glob("*.mcap*"))
    return [json.loads(message.payload) for message in messages(log) if message.topic == topic] if exists else []


class GrowingLog:
    """Follower of a log that reads each message once: to read the complete log every 10 ms occupies a processor.

    Args:
        log: run folder, which need not exist yet.
    """

    def __init__(self, log: Path) -> None:
        self._log = log
        self._restart()

    def _restart(self) -> None:
        self._tail = LogTail(self._log)
        self._new: defaultdict[str, list[bytes]] = defaultdict(list)
        self._decoded: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)

    def logged(self, topic: str) -> list[dict[str, Any]]:
        """All messages of a topic so far, in order; those of the present log if another one was replaced by it."""
        try:
            for message in self._tail.poll():
                self._new[message.topic].append(message.payload)
        except LogReplaced:
            self._restart()
        self._decoded[topic] += map(json.loads, self._new.pop(topic, ()))
        return list(self._decoded[topic])

    def states(self) -> list[str]:
        """All states that the run has entered, in order."""
        return [change["after"] for change in self.logged("/state")]
