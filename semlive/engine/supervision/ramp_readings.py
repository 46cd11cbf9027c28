"""An ordered ramp and its readings: the input of the supervision rules, and the noise thresholds.

`ramp_supervision` holds the theory of operation; `load_change`, `load_response`, `travel_response` and `extension_response` hold the rules.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity, LoadSample, MotionState
from semlive.engine.supervision.reading_noise import ReadingNoise

START_S = 1.0
"""Longest time in which a device begins a motion and reports it, s."""
STARTING_S = 1.25
"""Time whose ordered load change may stay unverified, s: the device starts, and some readings are needed to show it."""
MAX_UNVERIFIED_S = 10.0
"""Longest ramp without a noticeable load change, s, unless noise or resolution of the cell hides the change for longer."""
MEAN_READINGS = 5
"""Number of readings whose mean determines the progress."""
MIN_READINGS = 5
"""Smallest number of readings for the rules of missing progress."""
MIN_ORDERED_FRACTION = 0.25
"""Smallest fraction of the ordered change that counts as progress of the load, or as motion of the extension."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Why the device must stop.

    Attributes:
        code: kind of fault.
        reason: one sentence.
    """

    code: FaultCode
    reason: str


@dataclass(frozen=True, slots=True)
class Progress:
    """A reading of a ramp up to which the load is known to have moved.

    Attributes:
        sample: the reading; the time of later rests is added to its time.
        mean_n: mean of the latest force readings then, N; a single high reading would hide later progress.
        readings: number of readings since.
    """

    sample: LoadSample
    mean_n: float
    readings: int = 0


@dataclass(frozen=True, slots=True)
class OrderedRamp:
    """A ramp that was ordered.

    Attributes:
        target_n: target load, N.
        rate_n_s: rate of the load, N/s, > 0.
        tolerance_n: allowed deviation of the load from its target, N.
        start: the last sample before the order.
        anchor: the last reading up to which the load moved noticeably towards the target.
        midway: the first reading since the anchor at half of a noticeable change; None before. It is the next anchor.
        noise_n: largest value of `Readings.noticeable_n` in this ramp, N, because the estimate of the noise scatters.
        moved: the device has reported motion in this ramp.
        arrived: the device has rested within tolerance of the target after a motion in this ramp.
        response: the first sample at which the load had moved noticeably towards the target; None before.
        window: samples of the last half second, oldest first.
        marks: samples over some seconds, oldest first, between which a load-controlled ramp must progress; empty without motion.
    """

    target_n: float
    rate_n_s: float
    tolerance_n: float
    start: LoadSample
    anchor: Progress
    midway: Progress | None = None
    noise_n: float = 0.0
    moved: bool = False
    arrived: bool = False
    response: LoadSample | None = None
    window: tuple[LoadSample, ...] = ()
    marks: tuple[LoadSample, ...] = ()

    @property
    def sign(self) -> float:
        """+1 for a ramp upwards, -1 downwards."""
        return math.copysign(1.0, self.target_n - self.start.force_n)


@dataclass(frozen=True, slots=True)
class StandingExtension:
    """Duration of a constant extension reading during reported motion, now and in normal operation.

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


@dataclass(frozen=True, slots=True)
class Readings:
    """State of a device and of its readings.

    Attributes:
        limits: soft limits of the run.
        identity: identity of the device.
        force_noise: noise of the load cell.
        extension_noise: noise of the extension reading.
        stiffness_n_mm: load change per travel, learned from ramps; None before the first.
        standing: duration of the constant extension reading.
        last: the previous sample; None before the first.
    """

    limits: Limits
    identity: DeviceIdentity
    force_noise: ReadingNoise
    extension_noise: ReadingNoise
    stiffness_n_mm: float | None = None
    standing: StandingExtension = NEVER_CHANGED
    last: LoadSample | None = None

    def noticeable_n(self, ramp: OrderedRamp) -> float:
        """Return the smallest load change that exceeds the noise, N; quantisation counts up to the tolerance."""
        return self.force_noise.noticeable(ramp.tolerance_n)

    def near_n(self, ramp: OrderedRamp) -> float:
        """Return the distance from the target, N, within which a device may creep below its rate."""
        return max(ramp.tolerance_n, verified_within(ramp.rate_n_s, ramp.tolerance_n, self.noticeable_n(ramp)))

    def force_limit_n(self, ramp: OrderedRamp) -> float:
        """Return the force limit in the direction of the ramp, N, positive along the ramp."""
        return self.limits.force_max_n if ramp.sign > 0 else -self.limits.force_min_n


def verified_within(rate_n_s: float, tolerance_n: float, noticeable_n: float) -> float:
    """Return the largest ordered load change, N, that may stay unverified by the readings of a load-controlled ramp.

    Args:
        rate_n_s: rate of the ramp, N/s.
        tolerance_n: allowed deviation of the load from its target, N.
        noticeable_n: smallest change of the reading that exceeds the noise, N.

    The maximum of three values: four noticeable changes, so that motion at a quarter of the ordered rate is detected; the tolerance, for at
    most `MAX_UNVERIFIED_S`; and the change that is ordered while the device starts.
    """
    return max(4.0 * noticeable_n, min(tolerance_n, rate_n_s * MAX_UNVERIFIED_S), rate_n_s * STARTING_S)


def jitter_s(first: LoadSample, second: LoadSample) -> float:
    """Return the uncertainty of the interval between two readings, s, from response times and simulator lag."""
    wall_ns = second.mono_ns - first.mono_ns
    clock_rate = (second.time_ns - first.time_ns) / wall_ns if wall_ns > 0 else 1.0
    answers_s = ((first.rtt_s or 0.0) + (second.rtt_s or 0.0)) * max(clock_rate, 1.0)
    return answers_s + abs(first.simulator_lag_s or 0.0) + abs(second.simulator_lag_s or 0.0)


def seconds_between(first: LoadSample, second: LoadSample) -> float:
    """Return the experiment seconds between two samples."""
    return (second.time_ns - first.time_ns) / 1e9
