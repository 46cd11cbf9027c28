"""Clocks of tests, as `semlive.ports.ClockSource`."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass
class HandClock:
    """Wall time and experiment time are equal, and advance only when the test sets them."""

    ns: int = 10**18

    def now_ns(self) -> int:
        return self.ns

    def mono_ns(self) -> int:
        return self.ns


class WallClock:
    """Experiment time is wall time."""

    def now_ns(self) -> int:
        return time.time_ns()

    def mono_ns(self) -> int:
        return time.monotonic_ns()


class MonotonicClock:
    """Experiment time is the monotonic clock."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def mono_ns(self) -> int:
        return time.monotonic_ns()
