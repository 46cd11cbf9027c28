"""How long an extension reading has stood exactly still while the device reports motion, and how long it does when all is well."""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.loading import LoadSample, MotionState


@dataclass(frozen=True, slots=True)
class StandingExtension:
    """The extension reading since it last changed.

    Attributes:
        since: the sample at which it last changed, or the latest one at which no motion was ordered or reported; None before the first.
        since_n: mean of the latest force readings then, N.
        readings: so many readings since then show the same extension.
        changes: how often the reading has changed during ordered motion, in this run.
        longest_s: longest time between two such changes within one motion, s.
        from_change: `since` is a change during ordered motion.
    """

    since: LoadSample | None = None
    since_n: float = 0.0
    readings: int = 0
    changes: int = 0
    longest_s: float = 0.0
    from_change: bool = False

    def with_sample(self, sample: LoadSample, mean_n: float, ordered: bool) -> StandingExtension:
        """One reading more.

        Args:
            sample: the reading.
            mean_n: mean of the latest force readings, N.
            ordered: a ramp is under way.
        """
        if self.since is None or not ordered or sample.motion is not MotionState.MOVING:
            return replace(self, since=sample, since_n=mean_n, readings=0, from_change=False)
        if sample.extension_mm == self.since.extension_mm:
            return replace(self, readings=self.readings + 1)
        stood_s = (sample.time_ns - self.since.time_ns) / 1e9 if self.from_change else 0.0
        longest_s = max(self.longest_s, stood_s)
        return StandingExtension(sample, mean_n, 0, self.changes + 1, longest_s, from_change=True)


NEVER_CHANGED = StandingExtension()
"""Before the first reading."""
