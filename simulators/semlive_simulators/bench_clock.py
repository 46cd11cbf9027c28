"""The bench's clock: it publishes experiment time and stretches it when the simulation cannot keep up."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

from semlive.data.clock import Clock

STRETCH_AFTER_S = 1.0
"""Experiment seconds that a piece of work may be late before the clock is stretched for everybody."""


class BenchClock:
    """Experiment time for the bench's threads.

    Work is announced with `register_work` and reported with `done`; what is overdue in between is the lag.
    """

    def __init__(self, rate: float, publish: Callable[[Clock], None]) -> None:
        self._publish = publish
        self._lock = threading.Lock()
        self._latest_ns = 0
        self._due: dict[str, int] = {}
        self._worst_lag_s = 0.0
        self._running = False
        self._clock = Clock(time.time_ns(), time.monotonic_ns(), rate)
        self.start_ns = self._clock.utc0_ns

    def begin(self) -> None:
        """Let time pass from `start_ns` on, and publish the line; until then it stands still."""
        with self._lock:
            self._clock = Clock(self.start_ns, time.monotonic_ns(), self._clock.rate)
            self._running = True
            self._publish(self._clock)

    @property
    def stretches(self) -> int:
        """How often the clock was stretched."""
        return self._clock.revision

    @property
    def worst_lag_s(self) -> float:
        """The latest that any work was done after it was due, experiment seconds."""
        return self._worst_lag_s

    def now_ns(self) -> int:
        """Experiment time, UTC ns; stands still after a stretch until the line has caught up."""
        with self._lock:
            return self._now()

    def _now(self) -> int:
        line_ns = self._clock.time_ns(time.monotonic_ns()) if self._running else self.start_ns
        self._latest_ns = max(self._latest_ns, line_ns)
        return self._latest_ns

    def lag_s(self) -> float:
        """How far the simulation is behind this clock now, experiment seconds."""
        with self._lock:
            now = self._clock.time_ns(time.monotonic_ns())
            return max(0, max((now - due_ns for due_ns in self._due.values()), default=0)) * 1e-9

    def wait_until(self, time_ns: int, stop: threading.Event) -> bool:
        """Sleep until an experiment time; False if told to stop meanwhile."""
        while not stop.is_set():
            with self._lock:
                left_s = (self._clock.mono_ns(time_ns) - time.monotonic_ns()) * 1e-9
            if left_s <= 0:
                return True
            stop.wait(left_s)
        return False

    def register_work(self, work: str, due_ns: int) -> None:
        """Announce work that ought to be finished soon after `due_ns`."""
        with self._lock:
            self._due[work] = due_ns

    def done(self, work: str) -> None:
        """Report announced work; stretches the clock for everybody if it is too late."""
        with self._lock:
            due_ns = self._due.pop(work)
            late_ns = self._clock.time_ns(time.monotonic_ns()) - due_ns
            self._worst_lag_s = max(self._worst_lag_s, late_ns * 1e-9)
            if late_ns <= STRETCH_AFTER_S * 1e9:
                return
            self._clock = self._clock.stretched(late_ns)
            clock = self._clock
            self._publish(clock)
        sys.stderr.write(f"bench: {work} was {late_ns * 1e-9:.2f} s late; clock stretched by that (stretch {clock.revision})\n")
        sys.stderr.flush()
