"""An ordered ramp and the readings of it: the values that the rules of the supervision judge, and what counts as noise.

`ramp_supervision` holds the theory of operation; `load_change`, `load_response`, `travel_response` and `extension_response` hold the rules.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity, LoadSample
from semlive.engine.supervision.constant_extension import NEVER_CHANGED, StandingExtension
from semlive.engine.supervision.reading_noise import ReadingNoise

START_S = 1.0
"""A device may take this long to begin a motion and to report it."""
STARTING_S = 1.25
"""What a ramp orders in this time may stay unseen: the device starts, and some readings show it."""
MOST_UNSEEN_S = 10.0
"""No ramp may run for longer than this without a noticeable change of load, unless the cell's noise or resolution hides it for longer."""
AVERAGED = 5
"""Progress is that of the mean of so many readings."""
FEWEST_READINGS = 5
"""Missing progress is not judged on fewer readings."""
LEAST_OF_ORDERED = 0.25
"""A load that shows less than this part of what was ordered makes no progress; an extension that does shows no motion."""


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
class OrderedRamp:
    """A ramp that was ordered.

    Attributes:
        target_n: where to.
        rate_n_s: how fast, > 0.
        tolerance_n: allowed distance of the load from its target.
        start: the last sample before the order.
        anchor: the sample at which the load last moved noticeably towards the target.
        anchor_n: mean of the latest readings then: a single high one would hide the progress that follows.
        noise_n: largest change of the reading in this ramp that was taken for noise: the estimate scatters.
        since_anchor: readings since.
        response: the first sample at which the load had moved noticeably towards the target; None before.
        window: samples of the last half second, oldest first.
        marks: samples of some seconds, oldest first, between which a load-controlled ramp must come forward; none while it does not move.
    """

    target_n: float
    rate_n_s: float
    tolerance_n: float
    start: LoadSample
    anchor: LoadSample
    anchor_n: float
    noise_n: float = 0.0
    since_anchor: int = 0
    response: LoadSample | None = None
    window: tuple[LoadSample, ...] = ()
    marks: tuple[LoadSample, ...] = ()

    @property
    def sign(self) -> float:
        """+1 for a ramp upwards, -1 downwards."""
        return math.copysign(1.0, self.target_n - self.start.force_n)


@dataclass(frozen=True, slots=True)
class Readings:
    """What is known of device and readings.

    Attributes:
        limits: of the run.
        identity: of the device.
        force_noise: of the load cell.
        extension_noise: of the crosshead.
        stiffness_n_mm: load change per travel as learned from ramps; None before the first.
        standing: since when the extension reading has not changed.
        last: the sample before.
    """

    limits: Limits
    identity: DeviceIdentity
    force_noise: ReadingNoise
    extension_noise: ReadingNoise
    stiffness_n_mm: float | None = None
    standing: StandingExtension = NEVER_CHANGED
    last: LoadSample | None = None

    def noticeable_n(self, ramp: OrderedRamp) -> float:
        """A change of load that is no noise; a cell coarser than the tolerance could not be used."""
        return self.force_noise.noticeable(ramp.tolerance_n)

    def near_n(self, ramp: OrderedRamp) -> float:
        """Distance from the target within which a device may creep instead of keeping its rate."""
        return max(ramp.tolerance_n, verified_within(ramp.rate_n_s, ramp.tolerance_n, self.noticeable_n(ramp)))

    def force_limit_n(self, ramp: OrderedRamp) -> float:
        """The force limit in the direction of the ramp, N, counted along the ramp."""
        return self.limits.force_max_n if ramp.sign > 0 else -self.limits.force_min_n


def verified_within(rate_n_s: float, tolerance_n: float, noticeable_n: float) -> float:
    """Largest ordered change of load, N, that may stay unseen in the readings of a load-controlled ramp.

    Args:
        rate_n_s: of the ramp.
        tolerance_n: allowed distance of the load from its target.
        noticeable_n: change of the reading that is no noise.

    Four noticeable changes, so that a device at a quarter of the ordered rate is still seen to move; the tolerance, but not for longer
    than `MOST_UNSEEN_S`; and what is ordered while the device starts.
    """
    return max(4.0 * noticeable_n, min(tolerance_n, rate_n_s * MOST_UNSEEN_S), rate_n_s * STARTING_S)


def jitter_s(first: LoadSample, second: LoadSample) -> float:
    """How much further apart than their times say two readings may have been taken: answers take a while, simulators lag."""
    wall_ns = second.mono_ns - first.mono_ns
    clock_rate = (second.time_ns - first.time_ns) / wall_ns if wall_ns > 0 else 1.0
    answers_s = ((first.rtt_s or 0.0) + (second.rtt_s or 0.0)) * max(clock_rate, 1.0)
    return answers_s + abs(first.simulator_lag_s or 0.0) + abs(second.simulator_lag_s or 0.0)


def seconds_between(first: LoadSample, second: LoadSample) -> float:
    """Experiment seconds from one sample to another."""
    return (second.time_ns - first.time_ns) / 1e9
