"""Rules for the extension: extension and load must change together."""

from __future__ import annotations

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample
from semlive.engine.supervision.ramp_readings import MEAN_READINGS, START_S, Finding, OrderedRamp, Readings, seconds_between

EXTENSION_FLOOR_MM = 0.005
"""Travel that may not appear in the reading: encoders have steps of some um, which are unknown before the first change."""
_MIN_CHANGES = 3
"""Number of changes of the extension in ramps from which its steps and the times between them are determined."""
_MIN_CONSTANT_READINGS = 10
"""Smallest number of equal readings for the rule of a constant extension."""
_MIN_DUE_STEPS = 20.0
"""Smallest expected travel, in steps of the reading; allows a stiffness of this many times the learned one, as after a soft toe region."""
_CONSTANT_TIME_FACTOR = 3.0
"""Smallest duration of a constant extension, as a multiple of the longest time between two changes; slow sensors update rarely."""
_ALLOWED_RANGE_FRACTION = 0.05
"""Allowed load deficit at `limits.stiffness_min_n_mm`, as a fraction of the force limit: the toe region of grips and specimen."""


def learned_stiffness(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> float | None:
    """Return the largest load change per travel since the ramp began, N/mm, of readings well above the noise; None before the first."""
    force_n = ramp.sign * (sample.force_n - ramp.start.force_n)
    travel_mm = abs(sample.extension_mm - ramp.start.extension_mm)
    if force_n < 5.0 * readings.noticeable_n(ramp) or travel_mm < 5.0 * readings.extension_noise.noticeable() or travel_mm <= 0.0:
        return readings.stiffness_n_mm
    return max(readings.stiffness_n_mm or 0.0, force_n / travel_mm)


def extension_frozen(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """FROZEN_READING: the load changes, but the extension does not."""
    if not readings.identity.measures_extension:
        return None
    return _no_travel_since_start(readings, ramp, sample) or _extension_constant(readings, ramp, sample)


def _no_travel_since_start(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """Compare the travel since the begin of the ramp with the smallest possible travel, that at the stated (largest) stiffness."""
    stiffness = readings.identity.stiffness_n_mm
    if stiffness is None:
        return None
    change_n = abs(sample.force_n - ramp.start.force_n)
    min_travel_mm, travel_mm = change_n / stiffness, abs(sample.extension_mm - ramp.start.extension_mm)
    if (
        change_n <= max(5.0 * readings.noticeable_n(ramp), ramp.tolerance_n)
        or min_travel_mm <= max(5.0 * readings.extension_noise.noticeable(), EXTENSION_FLOOR_MM)
        or travel_mm > 0.1 * min_travel_mm
    ):
        return None
    what = f"the load changed by {change_n:.0f} N but the extension by {travel_mm:.4f} mm only, at least {min_travel_mm:.4f} mm are due"
    return Finding(FaultCode.FROZEN_READING, f"{what}: check the extension sensor and stiffness_n_mm")


def _extension_constant(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """Test whether an extension that followed the load before is exactly constant while the load progresses.

    The reading of a coarse or slow sensor is also constant at times. Its steps, and the times between its changes, determine the load
    progress from which a constant reading is a fault. A sensor that never changed is not tested here.
    """
    standing = readings.standing
    stiffness = max(readings.stiffness_n_mm or 0.0, readings.identity.stiffness_n_mm or 0.0)
    if standing.since is None or stiffness <= 0.0 or standing.changes < _MIN_CHANGES or standing.readings < _MIN_CONSTANT_READINGS:
        return None
    constant_s = seconds_between(standing.since, sample)
    progress_n = ramp.sign * (readings.force_noise.mean(MEAN_READINGS) - standing.since_n)
    noise = readings.extension_noise
    if (
        constant_s <= max(START_S, _CONSTANT_TIME_FACTOR * standing.longest_s)
        or progress_n <= max(5.0 * readings.noticeable_n(ramp), ramp.tolerance_n)
        or progress_n / stiffness <= _MIN_DUE_STEPS * max(noise.resolution, noise.smallest_step)
    ):
        return None
    what = f"the load changed by {progress_n:.0f} N within {constant_s:.1f} s while the extension reading was constant"
    return Finding(FaultCode.FROZEN_READING, f"{what} at {sample.extension_mm:.4f} mm: check the extension sensor and its range")


def owed_allowed_n(limits: Limits, tolerance_n: float, noticeable_n: float) -> float:
    """Return the allowed load deficit, N, of a travel at `limits.stiffness_min_n_mm`.

    Args:
        limits: soft limits of the run.
        tolerance_n: allowed deviation of the load from its target, N.
        noticeable_n: smallest change of the reading that exceeds the noise, N.
    """
    return max(_ALLOWED_RANGE_FRACTION * max(abs(limits.force_max_n), abs(limits.force_min_n)), tolerance_n, 1.5 * noticeable_n)


def too_compliant(readings: Readings, ramp: OrderedRamp, sample: LoadSample) -> Finding | None:
    """TRAVEL_WITHOUT_LOAD: since the first response, the load changed by less than `limits.stiffness_min_n_mm` times the travel.

    Only this rule finds a load cell that measures a fraction of the load: its reading follows the order while the load is far higher.
    """
    stiffness_min_n_mm, response = readings.limits.stiffness_min_n_mm, ramp.response
    if stiffness_min_n_mm is None or response is None or not readings.identity.measures_extension:
        return None
    travel_mm, change_n = abs(sample.extension_mm - response.extension_mm), ramp.sign * (sample.force_n - response.force_n)
    missing_n = stiffness_min_n_mm * (travel_mm - readings.extension_noise.noticeable()) - change_n
    if missing_n <= owed_allowed_n(readings.limits, ramp.tolerance_n, readings.noticeable_n(ramp)):
        return None
    what = f"the load changed by {change_n:.1f} N over {travel_mm:.4f} mm, {missing_n:.0f} N less than limits.stiffness_min_n_mm requires"
    return Finding(FaultCode.TRAVEL_WITHOUT_LOAD, f"{what}: check the scale of the load cell, grips and specimen, or correct the key")
