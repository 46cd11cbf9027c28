"""Rules for load control: the load must answer the ordered motion, and the motion must end at the target."""

from __future__ import annotations

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, LoadSample
from semlive.engine.supervision.ramp_readings import (
    AVERAGED,
    FEWEST_READINGS,
    START_S,
    Finding,
    OrderedRamp,
    Readings,
    seconds_between,
    verified_within,
)

SOONEST_S = 0.4
"""Missing progress is not judged sooner than this after the last progress."""
ARRIVED_AND_MOVING_S = 10.0
"""A device may report motion near its target for this long without progress: closed loops creep into their dead band."""
HEADROOM = 1.02
"""The unverified load may come up to this times the force limit; the bar for the true load is 1.05."""


def no_response(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """NO_RESPONSE: the load did not move noticeably since the anchor, although more was ordered than may stay unverified."""
    unseen_s, noticeable_n = seconds_between(ramp.anchor, sample), readings.noticeable_n(ramp)
    if readings.identity.control is ControlMode.DISPLACEMENT or ramp.since_anchor < FEWEST_READINGS or unseen_s <= SOONEST_S:
        return None
    travel_mm = abs(sample.extension_mm - ramp.anchor.extension_mm)
    reason = f"the load reading stays at {sample.force_n:.1f} N for {unseen_s:.1f} s although the device moves"
    advice = "check the load cell, its amplifier and the grips"
    near = abs(ramp.target_n - sample.force_n) <= readings.near_n(ramp)
    allowed_s = min(verified_within(ramp.rate_n_s, ramp.tolerance_n, noticeable_n) / ramp.rate_n_s, _headroom_s(readings, ramp, sample))
    if not near and unseen_s > max(allowed_s, START_S):
        return Finding(FaultCode.NO_RESPONSE, f"{reason}: {advice}")
    hidden_n = (readings.stiffness_n_mm or 0.0) * travel_mm
    # A yielding specimen lengthens fast under load control, but its load follows the order: it has progressed before this is looked at.
    due = ramp.rate_n_s * unseen_s >= 2.0 * noticeable_n and travel_mm > readings.extension_noise.noticeable()
    if due and hidden_n > max(2.0 * ramp.tolerance_n, 4.0 * noticeable_n):
        return Finding(FaultCode.NO_RESPONSE, f"{reason} by {travel_mm:.4f} mm, which is {hidden_n:.0f} N of load: {advice}")
    return None


def _headroom_s(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> float:
    """How long the ramp may go on unseen before the load can be at its limit; the averaged readings hide some of it already."""
    averaged_s = seconds_between(ramp.window[0], sample) / max(len(ramp.window) - 1, 1) * AVERAGED
    return (HEADROOM * readings.force_limit_n(ramp) - ramp.sign * sample.force_n) / ramp.rate_n_s - averaged_s


def overdue(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """MOTION_OVERDUE: the load is near its target, makes no progress, and the device still reports motion.

    A device creeps into its dead band with progress that is seen, so `ARRIVED_AND_MOVING_S` without any is long. Where the travel does not
    show that the load stands, the load may go on unseen; then the headroom below the force limit shortens the time.
    """
    near = abs(ramp.target_n - sample.force_n) <= readings.near_n(ramp)
    if not near or ramp.since_anchor < FEWEST_READINGS or readings.identity.control is ControlMode.DISPLACEMENT:
        return None
    unseen_s = seconds_between(ramp.anchor, sample)
    longest_s = max(ARRIVED_AND_MOVING_S, readings.near_n(ramp) / ramp.rate_n_s)
    stands = _readings_change(readings, ramp) and _load_stands(readings, ramp, abs(sample.extension_mm - ramp.anchor.extension_mm))
    if unseen_s <= (longest_s if stands else min(longest_s, max(_headroom_s(readings, ramp, sample), START_S))):
        return None
    what = (
        f"the load reading stays at {sample.force_n:.1f} N, near its target, but the device has reported motion for {unseen_s:.1f} s more"
    )
    return Finding(FaultCode.MOTION_OVERDUE, f"{what}: check whether the load cell still answers, and the device's dead band")


def _load_stands(readings: Readings, ramp: OrderedRamp, travel_mm: float) -> bool:
    """Whether the travel since the anchor shows that the load changed by the tolerance or its noise at most, at the learned stiffness."""
    if readings.stiffness_n_mm is None:
        return False
    within_n = max(ramp.tolerance_n, readings.noticeable_n(ramp))
    return travel_mm <= max(readings.extension_noise.noticeable(), within_n / readings.stiffness_n_mm)


def _readings_change(readings: Readings, ramp: OrderedRamp) -> bool:
    """Whether load or extension changed at all since the anchor: readings that all stand still show nothing, not even rest."""
    channels = (readings.force_noise, readings.extension_noise) if readings.identity.measures_extension else ()
    return any(len(set(channel.recent[-ramp.since_anchor :])) > 1 for channel in channels)
