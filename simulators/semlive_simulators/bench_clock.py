"""The clock of the bench: publishes experiment time, and stretches it when the simulation is too slow."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

from semlive.data.clock import Clock

STRETCH_AFTER_S = 1.0
"""Largest delay of a piece of work, experiment seconds, before the clock is stretched."""


class BenchClock:
    """Experiment time for the bench's threads.

    Work is announced with `register_work` and reported with `done`; the lag is the delay of overdue work.
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
        """Start time at `start_ns`, and publish the clock; before this call time does not advance."""
        with self._lock:
            self._clock = Clock(self.start_ns, time.monotonic_ns(), self._clock.rate)
            self._running = True
            self._publish(self._clock)

    @property
    def stretches(self) -> int:
        """Number of stretches of the clock."""
        return self._clock.revision

    @property
    def worst_lag_s(self) -> float:
        """Largest delay of any work, experiment seconds."""
        return self._worst_lag_s

    def now_ns(self) -> int:
        """Experiment time, UTC ns; after a stretch it does not advance until the clock has reached it."""
        with self._lock:
            return self._now()

    def _now(self) -> int:
        clock_ns = self._clock.now_ns(time.monotonic_ns()) if self._running else self.start_ns
        self._latest_ns = max(self._latest_ns, clock_ns)
        return self._latest_ns

    def lag_s(self) -> float:
        """Present delay of the simulation, experiment seconds."""
        with self._lock:
            now = self._clock.time_ns(time.monotonic_ns())
            return max(0, max((now - due_ns for due_ns in self._due.values()), default=0)) * 1e-9

    def wait_until(self, time_ns: int, stop: threading.Event) -> bool:
        """Sleep until an experiment time; False if `stop` is set before."""
        while not stop.is_set():
            with self._lock:
                remaining_s = (self._clock.mono_ns(time_ns) - time.monotonic_ns()) * 1e-9
            if remaining_s <= 0:
                return True
            stop.wait(remaining_s)
        return False

    def register_work(self, work: str, due_ns: int) -> None:
        """Announce work that is due at `due_ns`."""
        with self._lock:
            self._due[work] = due_ns

    def done(self, work: str) -> None:
        """Report announced work as done; stretches the clock if the work is too late."""
        with self._lock:
            due_ns = self._due.pop(work)
            mono_ns = time.monotonic_ns()
            late_ns = self._clock.time_ns(mono_ns) - due_ns
            self._worst_lag_s = max(self._worst_lag_s, late_ns * 1e-9)
            if late_ns <= STRETCH_AFTER_S * 1e9:
                return
            self._clock = self._clock.stretched(late_ns, mono_ns)
            clock = self._clock
            self._publish(clock)
        sys.stderr.write(f"bench: {work} was {late_ns * 1e-9:.2f} s late; clock stretched by that (stretch {clock.revision})\n")
        sys.stderr.flush()
