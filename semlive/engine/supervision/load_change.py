"""Rules for the load reading alone: its change during a ramp, compared with the order."""

from __future__ import annotations

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, LoadSample
from semlive.engine.supervision.ramp_readings import START_S, Finding, OrderedRamp, Readings, jitter_s, seconds_between

RATE_FACTOR = 1.5
"""Largest ratio of measured to ordered rate."""
RATE_WINDOW_S = 0.5
"""Time over which the largest rate is measured, s."""
SLOW_FACTOR = 0.2
"""Smallest ratio of measured to ordered rate in load control. In displacement control a yielding specimen slows the load."""
SLOW_WINDOW_S = 5.0
MARKS = 5
"""Number of intervals into which the window of the rule for slow ramps is divided."""
_JUMP_RANGE_FRACTION = 0.05
"""Difference of successive readings that is a jump, as a fraction of the force limit: EMI spikes, a lost sign, a slip."""


def jump_allowed_n(limits: Limits, tolerance_n: float, noticeable_n: float) -> float:
    """Return the largest difference, N, of two simultaneous readings that is not a jump.

    Args:
        limits: soft limits of the run.
        tolerance_n: allowed deviation of the load from its target, N.
        noticeable_n: smallest change of the reading that exceeds the noise, N.
    """
    return max(_JUMP_RANGE_FRACTION * max(abs(limits.force_max_n), abs(limits.force_min_n)), tolerance_n, 2.0 * noticeable_n)


def jump(previous: Readings, ramp: OrderedRamp | None, sample: LoadSample) -> Finding | None:
    """LOAD_JUMP: two successive readings differ by more than the ramp and the noise explain."""
    last = previous.last
    if last is None or sample.time_ns <= last.time_ns:
        return None
    limits, interval_s = previous.limits, seconds_between(last, sample)
    rate = limits.force_rate_max_n_s if ramp is None else ramp.rate_n_s
    tolerance_n = 0.0 if ramp is None else ramp.tolerance_n
    allowed_n = jump_allowed_n(limits, tolerance_n, previous.force_noise.noticeable(0.01 * abs(limits.force_max_n))) + 2.0 * rate * (
        interval_s + jitter_s(last, sample)
    )
    change_n = sample.force_n - last.force_n
    if limits.force_drop_max_n is not None and abs(sample.force_n) < abs(last.force_n) and sample.force_n * last.force_n >= 0:
        allowed_n = max(allowed_n, limits.force_drop_max_n)  # the configured bound of a sudden fall, checked by `LoadSupervisor`
    if abs(change_n) <= allowed_n:
        return None
    what = f"the load reading jumped from {last.force_n:.1f} to {sample.force_n:.1f} N within {interval_s:.2f} s"
    return Finding(FaultCode.LOAD_JUMP, f"{what}: check the load cell and its cable, the grips and the specimen")


def overshoot(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """OVERSHOOT: the load is beyond the target by more than the tolerance."""
    beyond_n = ramp.sign * (sample.force_n - ramp.target_n)
    if beyond_n <= max(ramp.tolerance_n, readings.noticeable_n(ramp)):
        return None
    what = (
        f"the load is {sample.force_n:.1f} N, beyond the ordered {ramp.target_n:g} N by more than the tolerance of {ramp.tolerance_n:g} N"
    )
    return Finding(FaultCode.OVERSHOOT, f"{what}: check the device's control and its load cell")


def too_fast(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """RATE_NOT_KEPT: within half a second, or since the ramp began, the load changed by more than 1.5 times the ordered rate."""
    allowance_n = max(ramp.tolerance_n, 1.5 * readings.noticeable_n(ramp))
    for first, delay_s in ((ramp.window[0], 0.0), (ramp.start, START_S)):
        interval_s = seconds_between(first, sample)
        if interval_s <= 0.0:
            continue
        change_n = ramp.sign * (sample.force_n - first.force_n)
        explained_n = RATE_FACTOR * ramp.rate_n_s * (interval_s + jitter_s(first, sample) + delay_s)
        if change_n > explained_n + allowance_n:
            what = f"the load changed by {change_n:.1f} N within {interval_s:.2f} s, but {ramp.rate_n_s:g} N/s was ordered"
            return Finding(FaultCode.RATE_NOT_KEPT, f"{what}: check the device's rate, its limits and stiffness_n_mm")
    return None


def slow_window_s(ramp: OrderedRamp) -> float:
    """Return the window of the rule for slow ramps, s: the expected progress is then twice the tolerance and the noise."""
    return max(SLOW_WINDOW_S, 2.0 * max(ramp.tolerance_n, 1.5 * ramp.noise_n) / (SLOW_FACTOR * ramp.rate_n_s))


def too_slow(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """RATE_NOT_KEPT: in load control, the load changed within 5 s by less than a fifth of the ordered rate."""
    near = abs(ramp.target_n - sample.force_n) <= readings.near_n(ramp)
    if len(ramp.marks) <= MARKS or near or readings.identity.control is ControlMode.DISPLACEMENT:
        return None
    first = ramp.marks[0]
    interval_s, change_n = seconds_between(first, sample), ramp.sign * (sample.force_n - first.force_n)
    if change_n >= SLOW_FACTOR * ramp.rate_n_s * interval_s - max(ramp.tolerance_n, 1.5 * ramp.noise_n):
        return None
    what = f"the load changed by {change_n:.1f} N only within {interval_s:.1f} s, but {ramp.rate_n_s:g} N/s was ordered"
    return Finding(FaultCode.RATE_NOT_KEPT, f"{what}: check the device's rate, its limits, grips and specimen")


def wrong_direction(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """WRONG_DIRECTION: the load moved away from the target by more than the tolerance."""
    reverse_n = -ramp.sign * (sample.force_n - ramp.start.force_n)
    if reverse_n <= max(ramp.tolerance_n, 1.5 * readings.noticeable_n(ramp)):
        return None
    what = f"the load went from {ramp.start.force_n:.1f} to {sample.force_n:.1f} N on its way to {ramp.target_n:g} N"
    return Finding(FaultCode.WRONG_DIRECTION, f"{what}: check the sign of the load cell and the direction of the drive")
