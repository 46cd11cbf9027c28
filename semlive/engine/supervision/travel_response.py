"""Rules for displacement control: travel must raise the load before the force limit can be reached, and readings must show it."""

from __future__ import annotations

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, LoadSample
from semlive.engine.supervision.ramp_readings import (
    MAX_UNVERIFIED_S,
    MIN_ORDERED_FRACTION,
    MIN_READINGS,
    START_S,
    Finding,
    OrderedRamp,
    Readings,
    seconds_between,
    verified_within,
)

CONSTANT_READINGS = 20
"""Number of exactly equal readings from which a load cell counts as frozen, because it shows no noise."""
STANDSTILL_S = 4.0
"""Longest standstill of a drive that has followed its orders in this ramp while travel is ordered, s."""
_FOLLOWED_STEPS = 5.0
"""Travel in this ramp, in noticeable changes, from which the extension follows the ordered travel."""
_AHEAD_S = 0.5
"""Default time for which the travel of a displacement drive is ordered ahead, s."""


def travel_without_load(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """TRAVEL_WITHOUT_LOAD, NO_RESPONSE: the load that the travel since the anchor would cause must stay below the force limit."""
    unverified_s = seconds_between(ramp.anchor.sample, sample)
    if readings.identity.control is not ControlMode.DISPLACEMENT or ramp.anchor.readings < MIN_READINGS or unverified_s <= START_S:
        return None
    travel_mm = abs(sample.extension_mm - ramp.anchor.sample.extension_mm)
    limits, stiffness = readings.limits, readings.identity.stiffness_n_mm
    noticeable_n = readings.noticeable_n(ramp)
    due_n = verified_within(ramp.rate_n_s, ramp.tolerance_n, noticeable_n)
    if readings.force_noise.constant(CONSTANT_READINGS) and ramp.response is not None and ramp.rate_n_s * unverified_s > due_n:
        what = f"the load reading is exactly {sample.force_n:.2f} N for {unverified_s:.1f} s although the crosshead moves"
        return Finding(FaultCode.NO_RESPONSE, f"{what}: check the load cell and its amplifier")
    limit_n = readings.force_limit_n(ramp)
    headroom_n = limit_n - ramp.sign * ramp.anchor.sample.force_n
    # Near the target the ordered travel is shorter: the remaining travel, in the time that is ordered ahead.
    near_n = max(ramp.tolerance_n, noticeable_n)
    near_target = abs(ramp.target_n - sample.force_n) <= near_n
    ordered_n = (min(ramp.rate_n_s, near_n / _AHEAD_S) if near_target else ramp.rate_n_s) * unverified_s
    min_mm = 0.0 if stiffness is None else MIN_ORDERED_FRACTION * ordered_n / stiffness
    if not readings.identity.measures_extension or travel_mm <= max(readings.extension_noise.noticeable(), min_mm):
        # An extension that is constant as well, or is not measured, does not limit the motion: the ordered travel counts.
        max_s = max(_standstill_s(readings, ramp, min_mm), 4.0 * ramp.noise_n / ramp.rate_n_s)
        return _ordered_without_answer(readings, sample, unverified_s, ordered_n, headroom_n if unverified_s <= max_s else 0.0)
    if limits.slack_max_mm is not None or stiffness is None:
        return None  # `LoadSupervisor` checks the travel
    hidden_n = stiffness * travel_mm
    if hidden_n <= headroom_n:
        return None
    what = f"the crosshead moved {travel_mm:.4f} mm while the load reading stayed at {sample.force_n:.1f} N"
    meaning = f"at stiffness_n_mm that is {hidden_n:.0f} N, which would reach the limit of {limit_n:g} N"
    return Finding(
        FaultCode.TRAVEL_WITHOUT_LOAD, f"{what}; {meaning}: check cell and grips, or set limits.slack_max_mm where slack is taken up"
    )


def _standstill_s(readings: Readings, ramp: OrderedRamp, min_mm: float) -> float:
    """Return the longest time in which neither load nor extension may show the ordered motion, s.

    `MAX_UNVERIFIED_S` while the extension has not followed the ordered travel in this ramp, or if its resolution or noise hides the
    expected travel; `STANDSTILL_S` if it has followed and is constant now.
    """
    noticeable_mm = readings.extension_noise.noticeable()
    followed_mm = abs(ramp.anchor.sample.extension_mm - ramp.start.extension_mm)
    follows = readings.identity.measures_extension and followed_mm > max(_FOLLOWED_STEPS * noticeable_mm, min_mm)
    return STANDSTILL_S if follows and min_mm > noticeable_mm else MAX_UNVERIFIED_S


def _ordered_without_answer(
    readings: Readings, sample: LoadSample, unverified_s: float, ordered_n: float, unverified_max_n: float
) -> Finding | None:
    """NO_RESPONSE: neither load nor extension shows the ordered motion of a displacement drive."""
    slack_mm, stiffness = readings.limits.slack_max_mm, readings.identity.stiffness_n_mm
    allowed_n = unverified_max_n if slack_mm is None or stiffness is None else stiffness * slack_mm
    if ordered_n <= allowed_n:
        return None
    what = (
        f"load and extension do not show the {ordered_n:.0f} N that were ordered "
        f"in {unverified_s:.1f} s, at a load of {sample.force_n:.1f} N"
    )
    return Finding(FaultCode.NO_RESPONSE, f"{what}: check drive, load cell, extension sensor, amplifier and grips")
