"""Soft limits, checked before each command and for each sample; the tighter of configuration and device applies."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.experiment import Limits, Plan
from semlive.data.loading import DeviceIdentity, LoadSample


def with_device_limits(limits: Limits, load_frame: DeviceIdentity | None) -> Limits:
    """Return `limits` with the force limit of the device where that is tighter."""
    if load_frame is None or load_frame.force_max_n is None:
        return limits
    device_n = abs(load_frame.force_max_n)
    return replace(limits, force_max_n=min(limits.force_max_n, device_n), force_min_n=max(limits.force_min_n, -device_n))


def sample_problem(limits: Limits, sample: LoadSample) -> str | None:
    """Return which limit a reading violates, as one message, or None. A NaN violates every limit."""
    if not limits.force_min_n <= sample.force_n <= limits.force_max_n:
        return f"the load is {sample.force_n:.1f} N, outside the limits {limits.force_min_n:g} to {limits.force_max_n:g} N"
    if not limits.extension_min_mm <= sample.extension_mm <= limits.extension_max_mm:
        return (
            f"the extension is {sample.extension_mm:.4f} mm, outside the limits "
            f"{limits.extension_min_mm:g} to {limits.extension_max_mm:g} mm"
        )
    return None


def ramp_problem(limits: Limits, target_n: float, rate_n_s: float, from_n: float, slack_n: float = 0.0) -> str | None:
    """Return why a ramp must not be commanded, as one message, or None.

    Args:
        limits: soft limits.
        target_n: target load, N.
        rate_n_s: rate of the load, N/s, > 0.
        from_n: load before the ramp, N.
        slack_n: allowance for the error of a measured `from_n`, N.
    """
    if not limits.force_min_n <= target_n <= limits.force_max_n:
        return f"a load of {target_n:g} N is outside the limits {limits.force_min_n:g} to {limits.force_max_n:g} N"
    if not 0 < rate_n_s <= limits.force_rate_max_n_s:
        return f"a ramp of {rate_n_s:g} N/s is outside the limit of {limits.force_rate_max_n_s:g} N/s"
    if not abs(target_n - from_n) <= limits.force_step_max_n + slack_n:
        return f"a change of load from {from_n:.1f} to {target_n:g} N is more than the limit of {limits.force_step_max_n:g} N in one step"
    return None


def move_problem(limits: Limits, shift_um: tuple[float, float]) -> str | None:
    """Return why a stage motion must not be commanded, as one message, or None."""
    if not max(abs(shift_um[0]), abs(shift_um[1])) <= limits.stage_travel_um:
        return f"a shift of ({shift_um[0]:g}, {shift_um[1]:g}) um is beyond the limit of {limits.stage_travel_um:g} um"
    return None


def plan_problem(plan: Plan, limits: Limits, first_step: int = 0) -> str | None:
    """Return the first limit violation in the steps of a plan, as one message, or None.

    The change of load of the first loaded step is not checked: its initial load is unknown until the device answers.
    """
    load_n: float | None = None
    for index, step in enumerate(plan.steps[first_step:], start=first_step):
        problem = move_problem(limits, step.shift_um)
        if problem is None and step.load_n is not None:
            problem = ramp_problem(limits, step.load_n, plan.ramp_rate_n_s, step.load_n if load_n is None else load_n)
            load_n = step.load_n
        if problem is not None:
            return f"step {index + 1}: {problem}"
    return None
