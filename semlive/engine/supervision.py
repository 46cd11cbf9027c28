"""Supervision of an ordered ramp: do the readings answer the motion, and as it was ordered?

Theory of operation
-------------------
A reading that stands still looks like a load that stands still. Nothing in a single reading shows that it is wrong: a frozen value, a
saturated amplifier with noise on it or a reversed sign are all finite numbers inside the limits. But semlive knows what it ordered. A ramp
of rate r must change the load by r t, so the load change that was ordered and has not been seen in the readings (the *unverified load*)
bounds how wrong they can be. Every rule below limits that quantity, so its consequence in newtons is known before the run
(`semlive.engine.stop_distance`), whatever is wrong.

For each reading of a ramp, in this order:

- LOAD_JUMP: two successive readings differ by more than the ramp and the noise explain (wrong sign, spike, slip, fracture). Always on.
- OVERSHOOT: the load is past the target by more than the tolerance.
- RATE_NOT_KEPT: within half a second, or since the ramp began, it changed by more than 1.5 times the ordered rate; or, in load control,
  within 5 s by less than a fifth of it.
- WRONG_DIRECTION: it went away from the target by more than the tolerance.
- NO_RESPONSE: since the load last moved noticeably towards the target (the *anchor*), more was ordered than `_verified_within` allows; or
  more than the headroom below the force limit; or the crosshead moved so far that the load should have changed (`stiffness`).
- FROZEN_READING: the load changes and the extension, which has to follow it, does not.
- MOTION_OVERDUE: the load is at its target and the device still reports motion, so perhaps it goes on and the reading does not show it.

A displacement drive may take up slack before the load rises, and a yielding specimen lengthens at a constant load. There NO_RESPONSE uses
the crosshead's travel and the force limit alone: the load that the travel would have made at the stated stiffness must stay below the
limit. `limits.slack_max_mm`, if it is set, replaces that bound. But a reading that has followed the ramp and then does not change at all,
not even by noise, is no yielding specimen.
Where the extension does not show the ordered motion either, because all readings stand still or none is measured, the ordered travel takes
the place of the measured one.

Devices need time to start: without a travel that is seen, progress is judged from 1 s on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, DeviceIdentity, LoadSample, MotionState
from semlive.engine.reading_noise import ReadingNoise

START_S = 1.0
"""A device may take this long to begin a motion and to report it."""
MOST_UNSEEN_S = 10.0
"""No ramp may run for longer than this without a noticeable change of load, unless the cell's noise or resolution hides it for longer."""
RATE_FACTOR = 1.5
"""A load that changes faster than this times the ordered rate does not keep it."""
_SOONEST_S = 0.4
SLOW_FACTOR = 0.2
"""A load-controlled ramp that makes less than this part of its rate does not keep it; displacement drives yield with the specimen."""
SLOW_WINDOW_S = 5.0
_MARKS = 5
RATE_WINDOW_S = 0.5
"""The rate is taken over this time."""
FEWEST_READINGS = 5
"""Missing progress is not judged on fewer readings."""
AVERAGED = 5
"""Progress is that of the mean of so many readings."""
EXTENSION_FLOOR_MM = 0.005
"""A travel up to this may not show: encoders step by some um, and a step is not known before the first one."""
CONSTANT_READINGS = 20
"""A cell whose readings do not differ at all over so many shows no noise."""
ARRIVED_AND_MOVING_S = 10.0
"""A device may report motion near its target for this long without progress: closed loops creep into their dead band."""
_JUMP_OF_RANGE = 0.05
"""Successive readings that differ by more than this part of the force limit are a jump: EMI spikes, a lost sign, a slip."""
_LEAST_OF_ORDERED = 0.25
"""A load that shows less than this part of what was ordered makes no progress; an extension that does shows no motion."""
_AHEAD_S = 0.5
"""Travel of a displacement drive is ordered ahead for this time, by default."""
HEADROOM = 1.02
"""The unverified load may come up to this times the force limit; the bar for the true load is 1.05."""


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
        responded: the load has moved noticeably towards the target since the order.
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
    responded: bool = False
    window: tuple[LoadSample, ...] = ()
    marks: tuple[LoadSample, ...] = ()

    @property
    def sign(self) -> float:
        """+1 for a ramp upwards, -1 downwards."""
        return math.copysign(1.0, self.target_n - self.start.force_n)


@dataclass(frozen=True, slots=True)
class Supervision:
    """What is known of the readings and of the ramp under way.

    Attributes:
        limits: of the run.
        identity: of the device.
        force_noise: of the load cell.
        extension_noise: of the crosshead.
        stiffness_n_mm: load change per travel as learned from ramps; None before the first.
        last: the sample before.
        ramp: the ramp under way; None if none was ordered or it was stopped.
    """

    limits: Limits
    identity: DeviceIdentity
    force_noise: ReadingNoise
    extension_noise: ReadingNoise
    stiffness_n_mm: float | None = None
    last: LoadSample | None = None
    ramp: OrderedRamp | None = None

    def ordered(self, target_n: float, rate_n_s: float, tolerance_n: float) -> Supervision:
        """A ramp was ordered now; before the first sample there is nothing to compare with."""
        if self.last is None:
            return self
        rate = max(rate_n_s, self.identity.rate_min_n_s)
        before_n = self.force_noise.mean(AVERAGED)
        return replace(self, ramp=OrderedRamp(target_n, rate, tolerance_n, self.last, self.last, before_n, window=(self.last,)))

    def stopped(self) -> Supervision:
        """The device was ordered to stop: no ramp is under way."""
        return replace(self, ramp=None)

    def with_sample(self, sample: LoadSample) -> tuple[Supervision, Finding | None]:
        """One reading more.

        Returns:
            The supervision, and why the device must stop, or None. A device that a person moves is not supervised.
        """
        if self.identity.control is ControlMode.MANUAL:
            return self, None
        finding = _jump(self, sample)
        seen = replace(
            self,
            last=sample,
            force_noise=self.force_noise.with_reading(sample.force_n),
            extension_noise=self.extension_noise.with_reading(sample.extension_mm),
        )
        if seen.ramp is None:
            return seen, finding
        ramp = _followed(seen, seen.ramp, sample)
        seen = replace(seen, ramp=ramp, stiffness_n_mm=_learned_stiffness(seen, ramp, sample))
        return seen, finding or _judged(seen, ramp, sample)


def supervise(limits: Limits, identity: DeviceIdentity) -> Supervision:
    """The supervision of a device before its first sample."""
    return Supervision(limits, identity, ReadingNoise(identity.force_resolution_n), ReadingNoise(identity.extension_resolution_mm))


def verified_within(rate_n_s: float, tolerance_n: float, noticeable_n: float) -> float:
    """Largest ordered change of load, N, that may stay unseen in the readings of a load-controlled ramp.

    Args:
        rate_n_s: of the ramp.
        tolerance_n: allowed distance of the load from its target.
        noticeable_n: change of the reading that is no noise.

    Four noticeable changes, so that a device at a quarter of the ordered rate is still seen to move; the tolerance, but not for longer
    than `MOST_UNSEEN_S`; and what is ordered while the device starts.
    """
    return max(4.0 * noticeable_n, min(tolerance_n, rate_n_s * MOST_UNSEEN_S), 1.25 * rate_n_s * START_S)


def jump_allowed_n(limits: Limits, tolerance_n: float, noticeable_n: float) -> float:
    """Largest difference, N, of two readings taken at the same time that is no jump.

    Args:
        limits: of the run.
        tolerance_n: allowed distance of the load from its target.
        noticeable_n: change of the reading that is no noise.
    """
    return max(_JUMP_OF_RANGE * max(abs(limits.force_max_n), abs(limits.force_min_n)), tolerance_n, 2.0 * noticeable_n)


def _jump(before: Supervision, sample: LoadSample) -> Finding | None:
    last, ramp = before.last, before.ramp
    if last is None or sample.time_ns <= last.time_ns:
        return None
    limits, apart_s = before.limits, (sample.time_ns - last.time_ns) / 1e9
    rate = limits.force_rate_max_n_s if ramp is None else ramp.rate_n_s
    tolerance_n = 0.0 if ramp is None else ramp.tolerance_n
    allowed_n = jump_allowed_n(limits, tolerance_n, before.force_noise.noticeable(0.01 * abs(limits.force_max_n))) + 2.0 * rate * (
        apart_s + _jitter_s(last, sample)
    )
    change_n = sample.force_n - last.force_n
    if limits.force_drop_max_n is not None and abs(sample.force_n) < abs(last.force_n) and sample.force_n * last.force_n >= 0:
        allowed_n = max(allowed_n, limits.force_drop_max_n)  # the run's own bound of a sudden fall, looked at by `LoadWatch`
    if abs(change_n) <= allowed_n:
        return None
    what = f"the load reading jumped from {last.force_n:.1f} to {sample.force_n:.1f} N within {apart_s:.2f} s"
    return Finding(FaultCode.LOAD_JUMP, f"{what}: check the load cell and its cable, the grips and the specimen")


def _jitter_s(first: LoadSample, second: LoadSample) -> float:
    """How much further apart than their times say two readings may have been taken: answers take a while, simulators lag."""
    wall_ns = second.mono_ns - first.mono_ns
    clock_rate = (second.time_ns - first.time_ns) / wall_ns if wall_ns > 0 else 1.0
    answers_s = ((first.rtt_s or 0.0) + (second.rtt_s or 0.0)) * max(clock_rate, 1.0)
    return answers_s + abs(first.simulator_lag_s or 0.0) + abs(second.simulator_lag_s or 0.0)


def _followed(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> OrderedRamp:
    """The ramp one reading later."""
    recent = tuple(one for one in ramp.window if one.time_ns > sample.time_ns - round(RATE_WINDOW_S * 1e9))
    window = (*(recent or ramp.window[-1:]), sample)
    mean_n = seen.force_noise.mean(AVERAGED)
    progress_n = ramp.sign * (mean_n - ramp.anchor_n)
    ramp = replace(ramp, noise_n=max(ramp.noise_n, _noticeable_n(seen, ramp)))
    anchored = progress_n > 0.0 and progress_n >= _progress_n(seen, ramp, sample)
    waiting = sample.motion is not MotionState.MOVING  # a device at rest owes no progress; it owes it from where it starts
    ramp = replace(ramp, marks=() if waiting else _marked(seen, ramp, sample))
    if anchored or waiting:
        responded = ramp.responded or anchored
        return replace(ramp, window=window, anchor=sample, anchor_n=mean_n, since_anchor=0, responded=responded)
    return replace(ramp, window=window, since_anchor=ramp.since_anchor + 1)


def _marked(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> tuple[LoadSample, ...]:
    apart_ns = round(_slow_window_s(seen, ramp) / _MARKS * 1e9)
    if ramp.marks and sample.time_ns - ramp.marks[-1].time_ns < apart_ns:
        return ramp.marks
    return (*ramp.marks, sample)[-_MARKS - 1 :]


def _slow_window_s(seen: Supervision, ramp: OrderedRamp) -> float:
    """Time over which a ramp that is too slow shows: the progress that is due is then twice what tolerance and noise may hide."""
    return max(SLOW_WINDOW_S, 2.0 * max(ramp.tolerance_n, 1.5 * ramp.noise_n) / (SLOW_FACTOR * ramp.rate_n_s))


def _progress_n(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> float:
    """What counts as progress of the load. Where the noise is estimated too small by chance, noise alone must not.

    In load control a part of what was ordered is due. In displacement control it is not, because the specimen may be more compliant than
    stated; there the largest estimate of the noise counts.
    """
    if seen.identity.control is ControlMode.DISPLACEMENT:
        return ramp.noise_n
    least_n = _LEAST_OF_ORDERED * ramp.rate_n_s * ((sample.time_ns - ramp.anchor.time_ns) / 1e9 - START_S)
    return max(_noticeable_n(seen, ramp), least_n)


def _noticeable_n(seen: Supervision, ramp: OrderedRamp) -> float:
    """A change of load that is no noise; a cell coarser than the tolerance could not be used."""
    return seen.force_noise.noticeable(ramp.tolerance_n)


def _near_n(seen: Supervision, ramp: OrderedRamp) -> float:
    """Distance from the target within which a device may creep instead of keeping its rate."""
    return max(ramp.tolerance_n, verified_within(ramp.rate_n_s, ramp.tolerance_n, _noticeable_n(seen, ramp)))


def _learned_stiffness(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> float | None:
    """Load change per travel since the ramp began, once both are well beyond their noise; the largest seen is kept."""
    force_n = ramp.sign * (sample.force_n - ramp.start.force_n)
    travel_mm = abs(sample.extension_mm - ramp.start.extension_mm)
    if force_n < 5.0 * _noticeable_n(seen, ramp) or travel_mm < 5.0 * seen.extension_noise.noticeable() or travel_mm <= 0.0:
        return seen.stiffness_n_mm
    return max(seen.stiffness_n_mm or 0.0, force_n / travel_mm)


def _judged(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    return (
        _overshoot(seen, ramp, sample)
        or _too_fast(seen, ramp, sample)
        or _too_slow(seen, ramp, sample)
        or _wrong_direction(seen, ramp, sample)
        or _no_response(seen, ramp, sample)
        or _extension_frozen(seen, ramp, sample)
        or _overdue(seen, ramp, sample)
    )


def _overshoot(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    beyond_n = ramp.sign * (sample.force_n - ramp.target_n)
    if beyond_n <= max(ramp.tolerance_n, _noticeable_n(seen, ramp)):
        return None
    what = (
        f"the load is {sample.force_n:.1f} N, beyond the ordered {ramp.target_n:g} N by more than the tolerance of {ramp.tolerance_n:g} N"
    )
    return Finding(FaultCode.OVERSHOOT, f"{what}: check the device's control and its load cell")


def _too_fast(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    allowance_n = max(ramp.tolerance_n, 1.5 * _noticeable_n(seen, ramp))
    for first, late_s in ((ramp.window[0], 0.0), (ramp.start, START_S)):
        apart_s = (sample.time_ns - first.time_ns) / 1e9
        if apart_s <= 0.0:
            continue
        change_n = ramp.sign * (sample.force_n - first.force_n)
        explained_n = RATE_FACTOR * ramp.rate_n_s * (apart_s + _jitter_s(first, sample) + late_s)
        if change_n > explained_n + allowance_n:
            what = f"the load changed by {change_n:.1f} N within {apart_s:.2f} s, but {ramp.rate_n_s:g} N/s was ordered"
            return Finding(FaultCode.RATE_NOT_KEPT, f"{what}: check the device's rate, its limits and stiffness_n_mm")
    return None


def _too_slow(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    near = abs(ramp.target_n - sample.force_n) <= _near_n(seen, ramp)
    if len(ramp.marks) <= _MARKS or near or seen.identity.control is ControlMode.DISPLACEMENT:
        return None
    first = ramp.marks[0]
    apart_s, change_n = (sample.time_ns - first.time_ns) / 1e9, ramp.sign * (sample.force_n - first.force_n)
    if change_n >= SLOW_FACTOR * ramp.rate_n_s * apart_s - max(ramp.tolerance_n, 1.5 * ramp.noise_n):
        return None
    what = f"the load changed by {change_n:.1f} N only within {apart_s:.1f} s, but {ramp.rate_n_s:g} N/s was ordered"
    return Finding(FaultCode.RATE_NOT_KEPT, f"{what}: check the device's rate, its limits, grips and specimen")


def _wrong_direction(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    back_n = -ramp.sign * (sample.force_n - ramp.start.force_n)
    if back_n <= max(ramp.tolerance_n, 1.5 * _noticeable_n(seen, ramp)):
        return None
    what = f"the load went from {ramp.start.force_n:.1f} to {sample.force_n:.1f} N on its way to {ramp.target_n:g} N"
    return Finding(FaultCode.WRONG_DIRECTION, f"{what}: check the sign of the load cell and the direction of the drive")


def _no_response(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    unseen_s, noticeable_n = (sample.time_ns - ramp.anchor.time_ns) / 1e9, _noticeable_n(seen, ramp)
    if ramp.since_anchor < FEWEST_READINGS or unseen_s <= _SOONEST_S:
        return None
    travel_mm = abs(sample.extension_mm - ramp.anchor.extension_mm)
    reason = f"the load reading stays at {sample.force_n:.1f} N for {unseen_s:.1f} s although the device moves"
    advice = "check the load cell, its amplifier and the grips"
    if seen.identity.control is ControlMode.DISPLACEMENT:
        return _travel_without_load(seen, ramp, sample, travel_mm, unseen_s) if unseen_s > START_S else None
    near = abs(ramp.target_n - sample.force_n) <= _near_n(seen, ramp)
    allowed_s = min(verified_within(ramp.rate_n_s, ramp.tolerance_n, noticeable_n) / ramp.rate_n_s, _headroom_s(seen, ramp, sample))
    if not near and unseen_s > max(allowed_s, START_S):
        return Finding(FaultCode.NO_RESPONSE, f"{reason}: {advice}")
    hidden_n = (seen.stiffness_n_mm or 0.0) * travel_mm
    # A yielding specimen lengthens fast under load control, but its load follows the order: it has progressed before this is looked at.
    due = ramp.rate_n_s * unseen_s >= 2.0 * noticeable_n and travel_mm > seen.extension_noise.noticeable()
    if due and hidden_n > max(2.0 * ramp.tolerance_n, 4.0 * noticeable_n):
        return Finding(FaultCode.NO_RESPONSE, f"{reason} by {travel_mm:.4f} mm, which is {hidden_n:.0f} N of load: {advice}")
    return None


def _headroom_s(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> float:
    """How long the ramp may go on unseen before the load can be at its limit; the averaged readings hide some of it already."""
    limit_n = HEADROOM * (seen.limits.force_max_n if ramp.sign > 0 else -seen.limits.force_min_n)
    averaged_s = (sample.time_ns - ramp.window[0].time_ns) / 1e9 / max(len(ramp.window) - 1, 1) * AVERAGED
    return (limit_n - ramp.sign * sample.force_n) / ramp.rate_n_s - averaged_s


def _travel_without_load(seen: Supervision, ramp: OrderedRamp, sample: LoadSample, travel_mm: float, unseen_s: float) -> Finding | None:
    """A displacement drive: the load that the travel since the anchor would make must stay below the force limit."""
    limits, stiffness = seen.limits, seen.identity.stiffness_n_mm
    due_n = verified_within(ramp.rate_n_s, ramp.tolerance_n, _noticeable_n(seen, ramp))
    if seen.force_noise.constant(CONSTANT_READINGS) and ramp.responded and ramp.rate_n_s * unseen_s > due_n:
        what = f"the load reading is exactly {sample.force_n:.2f} N for {unseen_s:.1f} s although the crosshead moves"
        return Finding(FaultCode.NO_RESPONSE, f"{what}: check the load cell and its amplifier")
    limit_n = limits.force_max_n if ramp.sign > 0 else -limits.force_min_n
    headroom_n = limit_n - ramp.sign * ramp.anchor.force_n
    # Near its target a drive is ordered shorter travel: what is missing, in the time that is ordered ahead.
    near_n = max(ramp.tolerance_n, _noticeable_n(seen, ramp))
    arriving = abs(ramp.target_n - sample.force_n) <= near_n
    ordered_n = (min(ramp.rate_n_s, near_n / _AHEAD_S) if arriving else ramp.rate_n_s) * unseen_s
    least_mm = 0.0 if stiffness is None else _LEAST_OF_ORDERED * ordered_n / stiffness
    if not seen.identity.measures_extension or travel_mm <= max(seen.extension_noise.noticeable(), least_mm):
        # An extension that stands still as well, or is not measured, does not hide the motion: what was ordered counts.
        longest_s = max(MOST_UNSEEN_S, 4.0 * ramp.noise_n / ramp.rate_n_s)
        return _ordered_without_answer(seen, sample, unseen_s, ordered_n, headroom_n if unseen_s <= longest_s else 0.0)
    if limits.slack_max_mm is not None or stiffness is None:
        return None  # `LoadWatch` looks at the travel
    hidden_n = stiffness * travel_mm
    if hidden_n <= headroom_n:
        return None
    what = f"the crosshead moved {travel_mm:.4f} mm while the load reading stayed at {sample.force_n:.1f} N"
    meaning = f"at stiffness_n_mm that is {hidden_n:.0f} N, which would reach the limit of {limit_n:g} N"
    return Finding(
        FaultCode.TRAVEL_WITHOUT_LOAD, f"{what}; {meaning}: check cell and grips, or set limits.slack_max_mm where slack is taken up"
    )


def _ordered_without_answer(
    seen: Supervision, sample: LoadSample, unseen_s: float, ordered_n: float, unseen_max_n: float
) -> Finding | None:
    """A displacement drive of which neither load nor extension shows the ordered motion."""
    slack_mm, stiffness = seen.limits.slack_max_mm, seen.identity.stiffness_n_mm
    allowed_n = unseen_max_n if slack_mm is None or stiffness is None else stiffness * slack_mm
    if ordered_n <= allowed_n:
        return None
    what = (
        f"load and extension do not show the {ordered_n:.0f} N that were ordered in {unseen_s:.1f} s, at a load of {sample.force_n:.1f} N"
    )
    return Finding(FaultCode.NO_RESPONSE, f"{what}: check load cell, extension sensor, amplifier and grips")


def _extension_frozen(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """At the stated stiffness, the largest possible, the travel of a load change is the smallest possible."""
    stiffness = seen.identity.stiffness_n_mm
    if stiffness is None or not seen.identity.measures_extension:
        return None
    change_n = abs(sample.force_n - ramp.start.force_n)
    least_mm, travel_mm = change_n / stiffness, abs(sample.extension_mm - ramp.start.extension_mm)
    if (
        change_n <= max(5.0 * _noticeable_n(seen, ramp), ramp.tolerance_n)
        or least_mm <= max(5.0 * seen.extension_noise.noticeable(), EXTENSION_FLOOR_MM)
        or travel_mm > 0.1 * least_mm
    ):
        return None
    what = f"the load changed by {change_n:.0f} N but the extension by {travel_mm:.4f} mm only, at least {least_mm:.4f} mm are due"
    return Finding(FaultCode.FROZEN_READING, f"{what}: check the extension sensor and stiffness_n_mm")


def _overdue(seen: Supervision, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """Near its target and moving: without a travel that is seen to stand still, nobody knows that the load does."""
    near = abs(ramp.target_n - sample.force_n) <= _near_n(seen, ramp)
    if not near or ramp.since_anchor < FEWEST_READINGS or seen.identity.control is ControlMode.DISPLACEMENT:
        return None
    unseen_s = (sample.time_ns - ramp.anchor.time_ns) / 1e9
    headroom_s = max(_headroom_s(seen, ramp, sample), START_S)
    longest_s = max(ARRIVED_AND_MOVING_S, _near_n(seen, ramp) / ramp.rate_n_s)
    travel_mm = abs(sample.extension_mm - ramp.anchor.extension_mm)
    stands = _readings_change(seen, ramp) and seen.stiffness_n_mm is not None and travel_mm <= seen.extension_noise.noticeable()
    if unseen_s <= (1.5 * longest_s if stands else min(longest_s, headroom_s)):
        return None
    what = (
        f"the load reading stays at {sample.force_n:.1f} N, near its target, but the device has reported motion for {unseen_s:.1f} s more"
    )
    return Finding(FaultCode.MOTION_OVERDUE, f"{what}: check whether the load cell still answers")


def _readings_change(seen: Supervision, ramp: OrderedRamp) -> bool:
    """Whether load or extension changed at all since the anchor: readings that all stand still show nothing, not even rest."""
    channels = (seen.force_noise, seen.extension_noise) if seen.identity.measures_extension else ()
    return any(len(set(one.recent[-ramp.since_anchor :])) > 1 for one in channels)
