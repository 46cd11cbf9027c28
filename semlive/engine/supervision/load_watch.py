"""Rules for successive readings: a load that falls or rises too fast, and crosshead travel without a load change.

The link thread and the engine both check every reading. A sudden fall of the load indicates a slipping grip or a broken specimen. The
reaction is always to stop and hold position.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.loading import LoadSample, MotionState

_WINDOW_NS = 500_000_000
"""Interval of compared readings, if available: at 20 Hz, noise of 2 N between successive readings would be a rate of 57 N/s."""
_MAX_READINGS = 256


@dataclass(frozen=True, slots=True)
class LoadSupervisor:
    """Earlier readings with which the next reading is compared.

    Attributes:
        recent: (experiment time ns, force in N), oldest first; the first is the one to compare with.
        last_load_change: (force in N, extension in mm) at the last noticeable load change, or at the last begin of crosshead motion.
        moving: the device reported motion with the last reading.
    """

    recent: tuple[tuple[int, float], ...] = ()
    last_load_change: tuple[float, float] | None = None
    moving: bool = False

    def with_sample(self, limits: Limits, sample: LoadSample) -> tuple[LoadSupervisor, str | None]:
        """Check one more reading.

        Returns:
            The updated supervisor, and a message on the limit that the reading violates relative to earlier readings, or None.
        """
        earlier = self.recent
        while len(earlier) > 1 and earlier[1][0] <= sample.time_ns - _WINDOW_NS:
            earlier = earlier[1:]
        problem = self._too_fast(earlier, limits, sample) or self._without_load(limits, sample)
        if earlier and sample.time_ns <= earlier[-1][0]:
            return self, problem
        recent = (*earlier, (sample.time_ns, sample.force_n))[-_MAX_READINGS:]
        moving = sample.motion is MotionState.MOVING
        last_change = self.last_load_change
        if last_change is None or not self.moving or abs(sample.force_n - last_change[0]) >= limits.slack_force_n:
            last_change = (sample.force_n, sample.extension_mm)
        # After a violation the comparison restarts, so one fall is reported once.
        after = replace(self, recent=recent if problem is None else recent[-1:], last_load_change=last_change, moving=moving)
        return (after if problem is None else replace(after, last_load_change=(sample.force_n, sample.extension_mm))), problem

    @staticmethod
    def _too_fast(earlier: tuple[tuple[int, float], ...], limits: Limits, sample: LoadSample) -> str | None:
        if not earlier or sample.time_ns <= earlier[0][0]:
            return None
        first_ns, first_n = earlier[0]
        interval_s, change_n = (sample.time_ns - first_ns) / 1e9, sample.force_n - first_n
        fell_n = abs(first_n) - abs(sample.force_n)
        # An ordered unloading may fall at the maximum ramp rate.
        ordered_n = limits.force_rate_max_n_s * interval_s if abs(sample.target_n) < abs(first_n) else 0.0
        if limits.force_drop_max_n is not None and not fell_n - ordered_n <= limits.force_drop_max_n:
            description = f"the load fell by {fell_n:.0f} N to {sample.force_n:.0f} N within {interval_s:.1f} s"
            return f"{description}: did the grips slip, or the specimen break?"
        if limits.force_slope_max_n_s is not None and not abs(change_n) <= limits.force_slope_max_n_s * max(interval_s, _WINDOW_NS / 1e9):
            return f"the load changes by {change_n / interval_s:+.0f} N/s, more than the limit of {limits.force_slope_max_n_s:g} N/s"
        return None

    def _without_load(self, limits: Limits, sample: LoadSample) -> str | None:
        if limits.slack_max_mm is None or self.last_load_change is None or not self.moving:
            return None
        if abs(sample.force_n - self.last_load_change[0]) >= limits.slack_force_n:
            return None
        travel_mm = abs(sample.extension_mm - self.last_load_change[1])
        if travel_mm <= limits.slack_max_mm:
            return None
        return f"the crosshead ran {travel_mm:.3f} mm while the load stayed at {sample.force_n:.0f} N: is the specimen held?"


INITIAL = LoadSupervisor()
"""Before the first reading."""
