"""Duration of a constant extension reading during reported motion, now and in normal operation."""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.loading import LoadSample, MotionState


@dataclass(frozen=True, slots=True)
class StandingExtension:
    """The extension reading since it last changed.

    Attributes:
        since: the sample of the last change, or the latest sample without ordered or reported motion; None before the first.
        since_n: mean of the latest force readings at `since`, N.
        readings: number of readings since then with the same extension.
        changes: number of changes of the reading during ordered motion in this run.
        longest_s: longest time between two such changes within one motion, s.
        from_change: `since` is the sample of a change during ordered motion.
    """

    since: LoadSample | None = None
    since_n: float = 0.0
    readings: int = 0
    changes: int = 0
    longest_s: float = 0.0
    from_change: bool = False

    def with_sample(self, sample: LoadSample, mean_n: float, ordered: bool) -> StandingExtension:
        """Return the state after one more reading.

        Args:
            sample: the reading.
            mean_n: mean of the latest force readings, N.
            ordered: a ramp is under way.
        """
        if self.since is None or not ordered or sample.motion is not MotionState.MOVING:
            return replace(self, since=sample, since_n=mean_n, readings=0, from_change=False)
        if sample.extension_mm == self.since.extension_mm:
            return replace(self, readings=self.readings + 1)
        constant_s = (sample.time_ns - self.since.time_ns) / 1e9 if self.from_change else 0.0
        longest_s = max(self.longest_s, constant_s)
        return StandingExtension(sample, mean_n, 0, self.changes + 1, longest_s, from_change=True)


NEVER_CHANGED = StandingExtension()
"""Before the first reading."""
