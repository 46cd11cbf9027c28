"""Rules for load control: the load must respond to the ordered motion, and the motion must end at the target."""

from __future__ import annotations

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, LoadSample
from semlive.engine.supervision.ramp_readings import (
    MEAN_READINGS,
    MIN_READINGS,
    START_S,
    Finding,
    OrderedRamp,
    Readings,
    seconds_between,
    verified_within,
)

MIN_UNVERIFIED_S = 0.4
"""Shortest time since the last progress after which missing progress is a fault, s."""
ARRIVED_AND_MOVING_S = 10.0
"""Longest reported motion near the target without progress, s: closed loops creep into their dead band."""
HEADROOM = 1.02
"""Largest unverified load, as a multiple of the force limit; the true load must stay below 1.05 times the limit."""


def no_response(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """NO_RESPONSE: no noticeable load change since the anchor, although the ordered change exceeds the largest unverified load."""
    unverified_s, noticeable_n = seconds_between(ramp.anchor.sample, sample), readings.noticeable_n(ramp)
    if readings.identity.control is ControlMode.DISPLACEMENT or ramp.anchor.readings < MIN_READINGS or unverified_s <= MIN_UNVERIFIED_S:
        return None
    travel_mm = abs(sample.extension_mm - ramp.anchor.sample.extension_mm)
    reason = f"the load reading stays at {sample.force_n:.1f} N for {unverified_s:.1f} s although the device moves"
    advice = "check the load cell, its amplifier and the grips"
    near = abs(ramp.target_n - sample.force_n) <= readings.near_n(ramp)
    allowed_s = min(verified_within(ramp.rate_n_s, ramp.tolerance_n, noticeable_n) / ramp.rate_n_s, _headroom_s(readings, ramp, sample))
    if not near and unverified_s > max(allowed_s, START_S):
        return Finding(FaultCode.NO_RESPONSE, f"{reason}: {advice}")
    hidden_n = (readings.stiffness_n_mm or 0.0) * travel_mm
    # A yielding specimen elongates fast in load control, but its load follows the order, so the anchor moves before this rule applies.
    due = ramp.rate_n_s * unverified_s >= 2.0 * noticeable_n and travel_mm > readings.extension_noise.noticeable()
    if due and hidden_n > max(2.0 * ramp.tolerance_n, 4.0 * noticeable_n):
        return Finding(FaultCode.NO_RESPONSE, f"{reason} by {travel_mm:.4f} mm, which is {hidden_n:.0f} N of load: {advice}")
    return None


def _headroom_s(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> float:
    """Return the time until an unverified load could reach its limit, s, reduced by the delay of the averaged readings."""
    averaged_s = seconds_between(ramp.window[0], sample) / max(len(ramp.window) - 1, 1) * MEAN_READINGS
    return (HEADROOM * readings.force_limit_n(ramp) - ramp.sign * sample.force_n) / ramp.rate_n_s - averaged_s


def overdue(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """MOTION_OVERDUE: the load is near its target, makes no progress, and the device still reports motion.

    A device that creeps into its dead band makes measurable progress, so `ARRIVED_AND_MOVING_S` without progress is long. If the travel
    does not show that the load is constant, the load may increase unobserved; the headroom below the force limit then shortens the time.
    """
    near = abs(ramp.target_n - sample.force_n) <= readings.near_n(ramp)
    if not near or ramp.anchor.readings < MIN_READINGS or readings.identity.control is ControlMode.DISPLACEMENT:
        return None
    unverified_s = seconds_between(ramp.anchor.sample, sample)
    max_s = max(ARRIVED_AND_MOVING_S, readings.near_n(ramp) / ramp.rate_n_s)
    load_constant = _readings_change(readings, ramp) and _load_constant(
        readings, ramp, abs(sample.extension_mm - ramp.anchor.sample.extension_mm)
    )
    if unverified_s <= (max_s if load_constant else min(max_s, max(_headroom_s(readings, ramp, sample), START_S))):
        return None
    what = (
        f"the load reading stays at {sample.force_n:.1f} N, near its target, "
        f"but the device has reported motion for {unverified_s:.1f} s more"
    )
    return Finding(FaultCode.MOTION_OVERDUE, f"{what}: check whether the load cell still answers, and the device's dead band")


def _load_constant(readings: Readings, ramp: OrderedRamp, travel_mm: float) -> bool:
    """Whether the travel since the anchor shows that the load changed by the tolerance or its noise at most, at the learned stiffness."""
    if readings.stiffness_n_mm is None:
        return False
    within_n = max(ramp.tolerance_n, readings.noticeable_n(ramp))
    return travel_mm <= max(readings.extension_noise.noticeable(), within_n / readings.stiffness_n_mm)


def _readings_change(readings: Readings, ramp: OrderedRamp) -> bool:
    """Whether a reading of load or extension changed since the anchor; exactly constant readings do not even prove rest."""
    channels = (readings.force_noise, readings.extension_noise) if readings.identity.measures_extension else ()
    return any(len(set(channel.recent[-ramp.anchor.readings :])) > 1 for channel in channels)
