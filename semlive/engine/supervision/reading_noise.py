"""Noise and resolution of a device's readings, estimated from the readings themselves."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from functools import lru_cache
from statistics import median

_MAX_READINGS = 33
_MIN_READINGS = 8
# Second differences of white noise have 6 times its variance; the median of absolute values is 0.6745 standard deviations.
_SIGMA_PER_MEDIAN = 1.0 / (0.6745 * math.sqrt(6.0))


@dataclass(frozen=True, slots=True)
class ReadingNoise:
    """Noise of one channel, from its latest readings.

    Second differences remove a constant rate, so a ramp does not count as noise; their median ignores single jumps.

    Attributes:
        resolution: declared resolution of the channel, in its unit; 0 if none is declared.
        recent: the latest readings, oldest first.
        smallest_step: smallest change between two successive readings; infinite before the first change.
    """

    resolution: float = 0.0
    recent: tuple[float, ...] = ()
    smallest_step: float = math.inf

    def with_reading(self, value: float) -> ReadingNoise:
        """Return the state after one more reading; a value that is not finite is ignored."""
        if not math.isfinite(value):
            return self
        step = abs(value - self.recent[-1]) if self.recent else 0.0
        smallest = min(self.smallest_step, step) if step > 0.0 else self.smallest_step
        return ReadingNoise(self.resolution, (*self.recent, value)[-_MAX_READINGS:], smallest)

    def mean(self, count: int) -> float:
        """Mean of the latest readings, at most `count`; NaN before the first."""
        latest = self.recent[-count:]
        return sum(latest) / len(latest) if latest else math.nan

    @property
    def sufficient(self) -> bool:
        """Whether there are enough readings for `sigma`."""
        return len(self.recent) >= _MIN_READINGS

    def constant(self, count: int) -> bool:
        """Whether the latest `count` readings, at most 33, are exactly the same."""
        return len(self.recent) >= count and len(set(self.recent[-count:])) == 1

    @property
    def sigma(self) -> float:
        """Standard deviation of one reading; 0 with fewer than 8 readings."""
        values = self.recent
        if len(values) < _MIN_READINGS:
            return 0.0
        return _SIGMA_PER_MEDIAN * median([abs(a - 2.0 * b + c) for a, b, c in zip(values, values[1:], values[2:], strict=False)])

    @property
    def least_step(self) -> float:
        """Smallest change of the channel: the declared resolution, or the quantisation step of the readings.

        The smallest observed step counts only if readings repeat exactly: a noisy channel with a fine format shows any step.
        """
        values = self.recent
        repeats = sum(map(operator.eq, values, values[1:]))
        quantised = math.isfinite(self.smallest_step) and 4 * repeats >= len(values)
        return max(self.resolution, self.smallest_step if quantised else 0.0)

    def noticeable(self, step_max: float = math.inf) -> float:
        """Return the largest change that noise explains: six standard deviations, or two steps of the channel.

        Args:
            step_max: largest quantisation step that is derived from readings. A fast ramp without noise looks like quantisation, too.
        """
        return _noticeable(self.resolution, self.recent, self.smallest_step, step_max)


# A dozen rules need the noise of the same readings: of force and extension, with the latest sample and without it.
@lru_cache(maxsize=4)
def _noticeable(resolution: float, recent: tuple[float, ...], smallest_step: float, step_max: float) -> float:
    """`ReadingNoise.noticeable` of a noise with these values."""
    noise = ReadingNoise(resolution, recent, smallest_step)
    return max(6.0 * noise.sigma, 2.0 * resolution, min(2.0 * noise.least_step, step_max))


NO_READINGS = ReadingNoise()
"""A channel of unknown resolution before its first reading."""
