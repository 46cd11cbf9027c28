"""Experiment time, the same in every process of a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Clock:
    """Experiment time as a straight line over the machine-wide monotonic clock.

    At an instrument the rate is 1 and experiment time is UTC; in a simulation the rate may be larger.
    A simulator that falls behind publishes a new line with a later ``mono0_ns`` ("stretched"); `revision` counts them.

    Attributes:
        utc0_ns: experiment time at `mono0_ns`, UTC ns since 1970.
        mono0_ns: reading of ``time.monotonic_ns()`` at that instant.
        rate: seconds of experiment time per second of wall time, > 0.
        revision: 0 for the first clock of a run, one more for each stretch.
    """

    utc0_ns: int
    mono0_ns: int
    rate: float = 1.0
    revision: int = 0

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(f"clock rate must be > 0, not {self.rate}")

    def time_ns(self, mono_ns: int) -> int:
        """Experiment time (UTC ns) at a reading of the monotonic clock."""
        return self.utc0_ns + round((mono_ns - self.mono0_ns) * self.rate)

    def mono_ns(self, time_ns: int) -> int:
        """Reading of the monotonic clock at an experiment time (UTC ns)."""
        return self.mono0_ns + round((time_ns - self.utc0_ns) / self.rate)

    def stretched(self, by_ns: int) -> Clock:
        """The same line set back by `by_ns` of experiment time: what was to happen at t happens that much later."""
        return Clock(self.utc0_ns - by_ns, self.mono0_ns, self.rate, self.revision + 1)
