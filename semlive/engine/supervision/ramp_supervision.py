"""Supervision of an ordered ramp: the readings must respond to the motion, and as it was ordered.

Theory of operation
-------------------
A frozen reading looks like a constant load. A single reading cannot show that it is wrong: a frozen value, a saturated amplifier with
noise, or a reversed sign are all finite numbers inside the limits. But semlive knows its order. A ramp of rate r must change the load by
r t, so the load change that was ordered and is not visible in the readings (the *unverified load*) bounds their error. Every rule below
limits that quantity, so its consequence in newtons is known before the run (`semlive.engine.supervision.stop_distance`), whatever fails.

For each reading of a ramp, in this order:

- LOAD_JUMP: two successive readings differ by more than the ramp and the noise explain (wrong sign, spike, slip, fracture). Always active.
- OVERSHOOT: the load is past the target by more than the tolerance.
- RATE_NOT_KEPT: within half a second, or since the ramp began, the load changed by more than 1.5 times the ordered rate; or, in load
  control, within 5 s by less than a fifth of it.
- WRONG_DIRECTION: the load moved away from the target by more than the tolerance.
- NO_RESPONSE: since the load last moved noticeably towards the target (the *anchor*), the ordered change exceeds the result of
  `verified_within`, or the headroom below the force limit; or the crosshead moved so far that the load should have changed (`stiffness`).
- TRAVEL_WITHOUT_LOAD: the load is smaller than `limits.stiffness_min_n_mm`, if it is set, times the travel. Only this rule detects a load
  cell that measures a fraction of the load: the device brings its reading to the target at the ordered rate.
- FROZEN_READING: the load changes and the extension, which has to follow it, does not: since the ramp began, at the stated stiffness; or
  since the extension last changed, at the learned stiffness and beyond the steps that the sensor has shown.
- MOTION_OVERDUE: the load is at its target and the device still reports motion, so it may still move without effect on the reading.

A displacement drive may take up slack before the load rises, and a yielding specimen lengthens at a constant load. There NO_RESPONSE uses
the travel of the crosshead and the force limit alone: the load that the travel would have caused at the stated stiffness must stay below
the limit. `limits.slack_max_mm`, if it is set, replaces that bound. But a reading that has followed the ramp and then does not change at
all, not even by noise, is no yielding specimen. If the extension does not show the ordered motion either, because all readings are frozen
or none is measured, the ordered travel replaces the measured travel; a drive that has followed its orders in this ramp counts as jammed
after some seconds.

Devices need time to start: without a measured travel, progress is evaluated from 1 s on. Time at rest does not count, but a rest short of
the target does not move the anchor: a drive whose orders come late rests between them.

The rules are in `load_change` (the load reading alone), `load_response` (load control), `travel_response` (displacement control) and
`extension_response`; `ramp_readings` holds the values that they evaluate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.loading import ControlMode, DeviceIdentity, LoadSample, MotionState
from semlive.engine.supervision.extension_response import extension_frozen, learned_stiffness, too_compliant
from semlive.engine.supervision.load_change import MARKS, RATE_WINDOW_S, jump, overshoot, slow_window_s, too_fast, too_slow, wrong_direction
from semlive.engine.supervision.load_response import no_response, overdue
from semlive.engine.supervision.ramp_readings import (
    MEAN_READINGS,
    MIN_ORDERED_FRACTION,
    START_S,
    Finding,
    OrderedRamp,
    Progress,
    Readings,
    seconds_between,
)
from semlive.engine.supervision.reading_noise import ReadingNoise
from semlive.engine.supervision.travel_response import travel_without_load

_RULES = (
    overshoot,
    too_fast,
    too_slow,
    wrong_direction,
    no_response,
    travel_without_load,
    too_compliant,
    extension_frozen,
    overdue,
)
"""In the order in which they are applied to each reading of a ramp; the first finding counts."""


@dataclass(frozen=True, slots=True)
class Supervision(Readings):
    """State of the readings and of the present ramp.

    Attributes:
        ramp: the present ramp; None if none was ordered or it was stopped.
    """

    ramp: OrderedRamp | None = None

    def ordered(self, target_n: float, rate_n_s: float, tolerance_n: float) -> Supervision:
        """Return the supervision after a ramp was ordered; unchanged before the first sample, the reference of a ramp."""
        if self.last is None:
            return self
        rate = max(rate_n_s, self.identity.rate_min_n_s)
        before_n = self.force_noise.mean(MEAN_READINGS)
        return replace(self, ramp=OrderedRamp(target_n, rate, tolerance_n, self.last, Progress(self.last, before_n), window=(self.last,)))

    def stopped(self) -> Supervision:
        """Return the supervision after a stop was ordered, without a ramp."""
        return replace(self, ramp=None)

    def with_sample(self, sample: LoadSample) -> tuple[Supervision, Finding | None]:
        """Check one more reading.

        Returns:
            The updated supervision, and why the device must stop, or None. A manually operated device is not supervised here.
        """
        if self.identity.control is ControlMode.MANUAL:
            return self, None
        finding = jump(self, self.ramp, sample)
        force_noise = self.force_noise.with_reading(sample.force_n)
        after = replace(
            self,
            last=sample,
            force_noise=force_noise,
            extension_noise=self.extension_noise.with_reading(sample.extension_mm),
            standing=self.standing.with_sample(sample, force_noise.mean(MEAN_READINGS), ordered=self.ramp is not None),
        )
        if after.ramp is None:
            return after, finding
        ramp = _updated_ramp(after, after.ramp, self.last, sample)
        after = replace(after, ramp=ramp, stiffness_n_mm=learned_stiffness(after, ramp, sample))
        findings = (rule(after, ramp, sample) for rule in _RULES)
        return after, finding or next((candidate for candidate in findings if candidate is not None), None)


def supervise(limits: Limits, identity: DeviceIdentity) -> Supervision:
    """Return the supervision of a device before its first sample."""
    return Supervision(limits, identity, ReadingNoise(identity.force_resolution_n), ReadingNoise(identity.extension_resolution_mm))


def _updated_ramp(readings: Readings, ramp: OrderedRamp, previous: LoadSample | None, sample: LoadSample) -> OrderedRamp:
    """Return the ramp after one more reading; `previous` is the reading before it."""
    recent = tuple(reading for reading in ramp.window if reading.time_ns > sample.time_ns - round(RATE_WINDOW_S * 1e9))
    window = (*(recent or ramp.window[-1:]), sample)
    stationary = sample.motion is not MotionState.MOVING  # progress is due only from the start of the motion
    within = abs(ramp.target_n - sample.force_n) <= max(ramp.tolerance_n, readings.noticeable_n(ramp))
    ramp = replace(
        ramp,
        window=window,
        noise_n=max(ramp.noise_n, readings.noticeable_n(ramp)),
        moved=ramp.moved or not stationary,
        arrived=ramp.arrived or (ramp.moved and stationary and within),
        marks=() if stationary else _updated_marks(ramp, sample),
    )
    here = Progress(sample, readings.force_noise.mean(MEAN_READINGS))
    if stationary and (ramp.arrived or not ramp.moved):
        return replace(ramp, anchor=here, midway=None)
    rest_ns = sample.time_ns - previous.time_ns if stationary and previous is not None and previous.motion is not MotionState.MOVING else 0
    midway = None if ramp.midway is None else _later(ramp.midway, rest_ns)
    return _with_progress(readings, replace(ramp, anchor=_later(ramp.anchor, rest_ns), midway=midway), here)


def _with_progress(readings: Readings, ramp: OrderedRamp, here: Progress) -> OrderedRamp:
    """Return the ramp with the reading `here`: the anchor moves to the midway reading when the load has moved noticeably.

    If a cell freezes just below a noticeable change, noise exceeds the change at some later time. With the anchor at that reading, 3 of 300
    simulated cells of a displacement drive hid 550 to 599 N instead of 340 N (limit 400 N). At the midway reading the load did move: half a
    noticeable change is three standard deviations of a reading, and more than six of the mean.
    """
    progress_n, noticeable_n = ramp.sign * (here.mean_n - ramp.anchor.mean_n), _progress_n(readings, ramp, here.sample)
    if progress_n <= 0.0 or progress_n < 0.5 * noticeable_n:
        return ramp
    midway = ramp.midway or here
    if progress_n < noticeable_n:
        return replace(ramp, midway=midway)
    return replace(ramp, anchor=midway, midway=None if midway is here else here, response=ramp.response or here.sample)


def _later(progress: Progress, rest_ns: int) -> Progress:
    """Return the progress after one more reading; the time of a rest is added to that of its sample, so that it does not count.

    A rest short of the target does not move the anchor: a drive whose orders come late rests between them. With a new anchor at each rest,
    a constant cell with noise was not found.
    """
    if rest_ns:
        return replace(progress, sample=replace(progress.sample, time_ns=progress.sample.time_ns + rest_ns))
    return replace(progress, readings=progress.readings + 1)


def _updated_marks(ramp: OrderedRamp, sample: LoadSample) -> tuple[LoadSample, ...]:
    interval_ns = round(slow_window_s(ramp) / MARKS * 1e9)
    if ramp.marks and sample.time_ns - ramp.marks[-1].time_ns < interval_ns:
        return ramp.marks
    return (*ramp.marks, sample)[-MARKS - 1 :]


def _progress_n(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> float:
    """Return the smallest load change that counts as progress, N. Noise alone must not count, even if its estimate is too small by chance.

    In load control a fraction of the ordered change is due. In displacement control it is not, because the specimen may be more compliant
    than stated; there the largest estimate of the noise is the limit.
    """
    if readings.identity.control is ControlMode.DISPLACEMENT:
        return ramp.noise_n
    min_n = MIN_ORDERED_FRACTION * ramp.rate_n_s * (seconds_between(ramp.anchor.sample, sample) - START_S)
    return max(readings.noticeable_n(ramp), min_n)
