"""Supervision of an ordered ramp: do the readings answer the motion, and as it was ordered?

Theory of operation
-------------------
A reading that stands still looks like a load that stands still. Nothing in a single reading shows that it is wrong: a frozen value, a
saturated amplifier with noise on it or a reversed sign are all finite numbers inside the limits. But semlive knows what it ordered. A ramp
of rate r must change the load by r t, so the load change that was ordered and has not been seen in the readings (the *unverified load*)
bounds how wrong they can be. Every rule below limits that quantity, so its consequence in newtons is known before the run
(`semlive.engine.supervision.stop_distance`), whatever is wrong.

For each reading of a ramp, in this order:

- LOAD_JUMP: two successive readings differ by more than the ramp and the noise explain (wrong sign, spike, slip, fracture). Always on.
- OVERSHOOT: the load is past the target by more than the tolerance.
- RATE_NOT_KEPT: within half a second, or since the ramp began, it changed by more than 1.5 times the ordered rate; or, in load control,
  within 5 s by less than a fifth of it.
- WRONG_DIRECTION: it went away from the target by more than the tolerance.
- NO_RESPONSE: since the load last moved noticeably towards the target (the *anchor*), more was ordered than `verified_within` allows; or
  more than the headroom below the force limit; or the crosshead moved so far that the load should have changed (`stiffness`).
- TRAVEL_WITHOUT_LOAD: the load is smaller than `limits.stiffness_min_n_mm`, if it is set, makes of the travel. A load cell that reads a
  part of the load shows nothing else: the device brings its reading to the target at the ordered rate.
- FROZEN_READING: the load changes and the extension, which has to follow it, does not: since the ramp began, at the stated stiffness; or
  since the extension last changed, at the learned stiffness and beyond the steps that the sensor has shown.
- MOTION_OVERDUE: the load is at its target and the device still reports motion, so perhaps it goes on and the reading does not show it.

A displacement drive may take up slack before the load rises, and a yielding specimen lengthens at a constant load. There NO_RESPONSE uses
the crosshead's travel and the force limit alone: the load that the travel would have made at the stated stiffness must stay below the
limit. `limits.slack_max_mm`, if it is set, replaces that bound. But a reading that has followed the ramp and then does not change at all,
not even by noise, is no yielding specimen.
Where the extension does not show the ordered motion either, because all readings stand still or none is measured, the ordered travel takes
the place of the measured one; a drive that has followed its orders in this ramp is jammed after some seconds of that.

Devices need time to start: without a travel that is seen, progress is judged from 1 s on.

The rules are in `load_change` (the load reading alone), `load_response` (load control), `travel_response` (displacement control) and
`extension_response`; `ramp_readings` holds the values that they judge.
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
    """What is known of the readings and of the ramp under way.

    Attributes:
        ramp: the ramp under way; None if none was ordered or it was stopped.
    """

    ramp: OrderedRamp | None = None

    def ordered(self, target_n: float, rate_n_s: float, tolerance_n: float) -> Supervision:
        """A ramp was ordered now; before the first sample there is nothing to compare with."""
        if self.last is None:
            return self
        rate = max(rate_n_s, self.identity.rate_min_n_s)
        before_n = self.force_noise.mean(MEAN_READINGS)
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
        ramp = _updated_ramp(after, after.ramp, sample)
        after = replace(after, ramp=ramp, stiffness_n_mm=learned_stiffness(after, ramp, sample))
        findings = (rule(after, ramp, sample) for rule in _RULES)
        return after, finding or next((candidate for candidate in findings if candidate is not None), None)


def supervise(limits: Limits, identity: DeviceIdentity) -> Supervision:
    """The supervision of a device before its first sample."""
    return Supervision(limits, identity, ReadingNoise(identity.force_resolution_n), ReadingNoise(identity.extension_resolution_mm))


def _updated_ramp(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> OrderedRamp:
    """The ramp one reading later."""
    recent = tuple(reading for reading in ramp.window if reading.time_ns > sample.time_ns - round(RATE_WINDOW_S * 1e9))
    window = (*(recent or ramp.window[-1:]), sample)
    mean_n = readings.force_noise.mean(MEAN_READINGS)
    progress_n = ramp.sign * (mean_n - ramp.anchor_n)
    ramp = replace(ramp, noise_n=max(ramp.noise_n, readings.noticeable_n(ramp)))
    anchored = progress_n > 0.0 and progress_n >= _progress_n(readings, ramp, sample)
    stationary = sample.motion is not MotionState.MOVING  # a device at rest owes no progress; it owes it from where it starts
    ramp = replace(ramp, marks=() if stationary else _updated_marks(ramp, sample))
    if anchored or stationary:
        response = ramp.response or (sample if anchored else None)
        return replace(ramp, window=window, anchor=sample, anchor_n=mean_n, since_anchor=0, response=response)
    return replace(ramp, window=window, since_anchor=ramp.since_anchor + 1)


def _updated_marks(ramp: OrderedRamp, sample: LoadSample) -> tuple[LoadSample, ...]:
    interval_ns = round(slow_window_s(ramp) / MARKS * 1e9)
    if ramp.marks and sample.time_ns - ramp.marks[-1].time_ns < interval_ns:
        return ramp.marks
    return (*ramp.marks, sample)[-MARKS - 1 :]


def _progress_n(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> float:
    """What counts as progress of the load. Where the noise is estimated too small by chance, noise alone must not.

    In load control a part of what was ordered is due. In displacement control it is not, because the specimen may be more compliant than
    stated; there the largest estimate of the noise counts.
    """
    if readings.identity.control is ControlMode.DISPLACEMENT:
        return ramp.noise_n
    min_n = MIN_ORDERED_FRACTION * ramp.rate_n_s * (seconds_between(ramp.anchor, sample) - START_S)
    return max(readings.noticeable_n(ramp), min_n)
