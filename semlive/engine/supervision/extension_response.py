"""Rules about the extension: it must follow the load, and the load must follow it."""

from __future__ import annotations

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample
from semlive.engine.supervision.ramp_readings import AVERAGED, START_S, Finding, OrderedRamp, Readings, seconds_between

EXTENSION_FLOOR_MM = 0.005
"""A travel up to this may not show: encoders step by some um, and a step is not known before the first one."""
_FEWEST_CHANGES = 3
"""Changes of the extension in ramps before its steps and the times between them are known."""
_FEWEST_STANDING = 10
"""An extension that stands still is not judged on fewer readings."""
_STANDING_STEPS = 20.0
"""Travel that is due, in steps of the extension reading: the stiffness may be so many times the learned one, as after a soft toe region."""
_STANDING_TIMES = 3.0
"""The extension must stand still for so many times as long as it ever did between two changes: slow sensors give a value now and then."""
_ALLOWED_OF_RANGE = 0.05
"""Load that the travel may owe at `limits.stiffness_min_n_mm`, as a part of the force limit: the toe region of grips and specimen."""


def learned_stiffness(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> float | None:
    """Load change per travel since the ramp began, N/mm, once both are well beyond their noise; the largest is kept."""
    force_n = ramp.sign * (sample.force_n - ramp.start.force_n)
    travel_mm = abs(sample.extension_mm - ramp.start.extension_mm)
    if force_n < 5.0 * readings.noticeable_n(ramp) or travel_mm < 5.0 * readings.extension_noise.noticeable() or travel_mm <= 0.0:
        return readings.stiffness_n_mm
    return max(readings.stiffness_n_mm or 0.0, force_n / travel_mm)


def extension_frozen(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """FROZEN_READING: the load changes and the extension, which has to follow it, does not."""
    if not readings.identity.measures_extension:
        return None
    return _no_travel_since_start(readings, ramp, sample) or _stands_still(readings, ramp, sample)


def _no_travel_since_start(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """At the stated stiffness, the largest possible, the travel of a load change is the smallest possible."""
    stiffness = readings.identity.stiffness_n_mm
    if stiffness is None:
        return None
    change_n = abs(sample.force_n - ramp.start.force_n)
    least_mm, travel_mm = change_n / stiffness, abs(sample.extension_mm - ramp.start.extension_mm)
    if (
        change_n <= max(5.0 * readings.noticeable_n(ramp), ramp.tolerance_n)
        or least_mm <= max(5.0 * readings.extension_noise.noticeable(), EXTENSION_FLOOR_MM)
        or travel_mm > 0.1 * least_mm
    ):
        return None
    what = f"the load changed by {change_n:.0f} N but the extension by {travel_mm:.4f} mm only, at least {least_mm:.4f} mm are due"
    return Finding(FaultCode.FROZEN_READING, f"{what}: check the extension sensor and stiffness_n_mm")


def _stands_still(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """The extension followed the load before, and has been exactly constant since while the load made progress.

    A coarse or slow sensor stands still as well. Its own steps, and the times between its changes, set how far the load must come before
    a constant reading is a fault; a sensor that never changed sets nothing and is not judged here.
    """
    standing = readings.standing
    stiffness = max(readings.stiffness_n_mm or 0.0, readings.identity.stiffness_n_mm or 0.0)
    if standing.since is None or stiffness <= 0.0 or standing.changes < _FEWEST_CHANGES or standing.readings < _FEWEST_STANDING:
        return None
    stood_s = seconds_between(standing.since, sample)
    progress_n = ramp.sign * (readings.force_noise.mean(AVERAGED) - standing.since_n)
    noise = readings.extension_noise
    if (
        stood_s <= max(START_S, _STANDING_TIMES * standing.longest_s)
        or progress_n <= max(5.0 * readings.noticeable_n(ramp), ramp.tolerance_n)
        or progress_n / stiffness <= _STANDING_STEPS * max(noise.resolution, noise.smallest_step)
    ):
        return None
    what = f"the load changed by {progress_n:.0f} N within {stood_s:.1f} s while the extension reading stood still"
    return Finding(FaultCode.FROZEN_READING, f"{what} at {sample.extension_mm:.4f} mm: check the extension sensor and its range")


def owed_allowed_n(limits: Limits, tolerance_n: float, noticeable_n: float) -> float:
    """Load, N, that a travel may owe at `limits.stiffness_min_n_mm`.

    Args:
        limits: of the run.
        tolerance_n: allowed distance of the load from its target.
        noticeable_n: change of the reading that is no noise.
    """
    return max(_ALLOWED_OF_RANGE * max(abs(limits.force_max_n), abs(limits.force_min_n)), tolerance_n, 1.5 * noticeable_n)


def too_compliant(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """TRAVEL_WITHOUT_LOAD: since the load first moved, it changed by less than `limits.stiffness_min_n_mm` makes of the travel.

    Nothing else shows a load cell that reads a part of the load: its reading moves at the ordered rate while the load is far higher.
    """
    least_n_mm, first = readings.limits.stiffness_min_n_mm, ramp.response
    if least_n_mm is None or first is None or not readings.identity.measures_extension:
        return None
    travel_mm, change_n = abs(sample.extension_mm - first.extension_mm), ramp.sign * (sample.force_n - first.force_n)
    owed_n = least_n_mm * (travel_mm - readings.extension_noise.noticeable()) - change_n
    if owed_n <= owed_allowed_n(readings.limits, ramp.tolerance_n, readings.noticeable_n(ramp)):
        return None
    what = f"the load changed by {change_n:.1f} N over {travel_mm:.4f} mm, {owed_n:.0f} N less than limits.stiffness_min_n_mm requires"
    return Finding(FaultCode.TRAVEL_WITHOUT_LOAD, f"{what}: check the scale of the load cell, grips and specimen, or correct the key")
