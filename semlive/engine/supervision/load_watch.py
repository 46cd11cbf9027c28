"""What two readings tell that one does not: a load that falls or rises too fast, a crosshead that runs without pulling.

The link thread asks this of every reading, and so does the engine. A sudden fall of the load is a grip that slips or a specimen that
breaks; what follows is always the same: stop, and hold position.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.loading import LoadSample, MotionState

_APART_NS = 500_000_000
"""Readings are compared half a second apart, or as far as they are: noise of 2 N from one to the next at 20 Hz would be 57 N/s."""
_KEPT = 256


@dataclass(frozen=True, slots=True)
class LoadSupervisor:
    """The readings that the next one is compared with.

    Attributes:
        recent: (experiment time ns, force in N), oldest first; the first is the one to compare with.
        last_load_change: (force in N, extension in mm) where the load last changed noticeably, or the crosshead last began to run.
        moving: the device said so with the last reading.
    """

    recent: tuple[tuple[int, float], ...] = ()
    last_load_change: tuple[float, float] | None = None
    moving: bool = False

    def with_sample(self, limits: Limits, sample: LoadSample) -> tuple[LoadSupervisor, str | None]:
        """One reading more.

        Returns:
            What to compare the next reading with, and which limit this one violates beside the earlier ones, as a sentence, or None.
        """
        earlier = self.recent
        while len(earlier) > 1 and earlier[1][0] <= sample.time_ns - _APART_NS:
            earlier = earlier[1:]
        problem = self._too_fast(earlier, limits, sample) or self._without_load(limits, sample)
        if earlier and sample.time_ns <= earlier[-1][0]:
            return self, problem
        recent = (*earlier, (sample.time_ns, sample.force_n))[-_KEPT:]
        moving = sample.motion is MotionState.MOVING
        taken_up = self.last_load_change
        if taken_up is None or not self.moving or abs(sample.force_n - taken_up[0]) >= limits.slack_force_n:
            taken_up = (sample.force_n, sample.extension_mm)
        # After a violation it is compared anew: one fall is told once.
        after = replace(self, recent=recent if problem is None else recent[-1:], last_load_change=taken_up, moving=moving)
        return (after if problem is None else replace(after, last_load_change=(sample.force_n, sample.extension_mm))), problem

    @staticmethod
    def _too_fast(earlier: tuple[tuple[int, float], ...], limits: Limits, sample: LoadSample) -> str | None:
        if not earlier or sample.time_ns <= earlier[0][0]:
            return None
        then_ns, then_n = earlier[0]
        apart_s, change_n = (sample.time_ns - then_ns) / 1e9, sample.force_n - then_n
        fell_n = abs(then_n) - abs(sample.force_n)
        # A load that is taken off on purpose falls as fast as a ramp may be.
        on_purpose_n = limits.force_rate_max_n_s * apart_s if abs(sample.target_n) < abs(then_n) else 0.0
        if limits.force_drop_max_n is not None and not fell_n - on_purpose_n <= limits.force_drop_max_n:
            fell = f"the load fell by {fell_n:.0f} N to {sample.force_n:.0f} N within {apart_s:.1f} s"
            return f"{fell}: did the grips slip, or the specimen break?"
        if limits.force_slope_max_n_s is not None and not abs(change_n) <= limits.force_slope_max_n_s * max(apart_s, _APART_NS / 1e9):
            return f"the load changes by {change_n / apart_s:+.0f} N/s, more than the limit of {limits.force_slope_max_n_s:g} N/s"
        return None

    def _without_load(self, limits: Limits, sample: LoadSample) -> str | None:
        if limits.slack_max_mm is None or self.last_load_change is None or not self.moving:
            return None
        if abs(sample.force_n - self.last_load_change[0]) >= limits.slack_force_n:
            return None
        ran_mm = abs(sample.extension_mm - self.last_load_change[1])
        if ran_mm <= limits.slack_max_mm:
            return None
        return f"the crosshead ran {ran_mm:.3f} mm while the load stayed at {sample.force_n:.0f} N: is the specimen held?"


INITIAL = LoadSupervisor()
"""Before the first reading."""
