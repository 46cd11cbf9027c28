"""Stop distances where a reading does not show the load, so that the rules of missing progress stop the ramp.

The force reading freezes, the load cell measures only a fraction of the load, or no reading shows the motion. The rules allow a load change
that depends on control mode, noise and configuration; a row without a bound names the key that bounds it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from semlive.data.faults import FaultCode
from semlive.engine.motion import MAX_APPROACHES
from semlive.engine.supervision.extension_response import owed_allowed_n
from semlive.engine.supervision.load_response import ARRIVED_AND_MOVING_S, HEADROOM
from semlive.engine.supervision.ramp_readings import MAX_UNVERIFIED_S
from semlive.engine.supervision.stop_distance.case import FASTEST_FACTOR, MIN_SHOWN_FACTOR, StopDistance
from semlive.engine.supervision.stop_distance.sums import FREEZING_LOAD, RampSums
from semlive.engine.supervision.travel_response import STANDSTILL_S

_STATE_STIFFNESS = (
    "limits.extension_max_mm alone bounds it, where the extension is measured; check the scale of the cell with a known load, and set "
    "limits.stiffness_min_n_mm, or extension_max_mm to what the plan needs"
)
_EARLY_TOLERANCES = 3.0
"""Largest length of a ramp, in tolerances, that is ordered again if it does not begin, instead of being a fault at once."""


def load(sums: RampSums) -> Iterator[StopDistance]:
    """Yield the rows of load control in which the reading does not show the load."""
    beyond = sums.averaged_n + max(sums.verified_n, sums.soonest_n) + sums.late_n
    yield sums.row(
        FaultCode.NO_RESPONSE,
        "the force reading freezes or saturates on the way",
        reference=FREEZING_LOAD,
        beyond=beyond,
        worst=max(sums.start_n, sums.target_n - sums.near_n) + beyond,
    )
    latest = sums.target_n + max(sums.case.tolerance_n, sums.case.noticeable_n)
    longest = sums.rate_n_s * max(ARRIVED_AND_MOVING_S, sums.near_n / sums.rate_n_s)
    waits = max(min(longest, HEADROOM * sums.limit_n - latest), sums.soonest_n)
    worst = latest + sums.averaged_n + waits + sums.late_n
    yield sums.row(
        FaultCode.MOTION_OVERDUE,
        "the readings freeze near the target and the device continues to move",
        beyond=worst - sums.target_n,
        worst=worst,
        remark="less where the extension shows the travel and the stiffness is known from earlier ramps",
    )
    yield _all_frozen_at_rest(sums)


def _all_frozen_at_rest(sums: RampSums) -> StopDistance:
    """All readings and the report of motion are frozen since before the ramp: the engine finds that the load was not reached."""
    case = sums.case
    small = abs(case.target_n - case.start_n) <= _EARLY_TOLERANCES * case.tolerance_n
    approaches = 1 + (MAX_APPROACHES if small else 0)
    seconds = approaches * (case.settle_s + 2.0 * case.poll_s) + sums.late_s
    return sums.row(
        FaultCode.NOT_REACHED if small else FaultCode.STOPPED_EARLY,
        "everything that the device reports, motion included, is frozen since before the ramp",
        reference="the load before the ramp",
        beyond=sums.rate_n_s * seconds,
        worst=sums.start_n + sums.rate_n_s * seconds,
        seconds=seconds,
    )


def travel(sums: RampSums) -> Iterator[StopDistance]:
    """Yield the rows of displacement control in which the travel changes no load reading."""
    case, fault = sums.case, "the force reading is frozen while the crosshead moves"
    if case.stiffness_n_mm is None:
        yield sums.unbounded(FaultCode.LIMIT, fault, "the extension limits alone bound it: state the stiffness")
    elif case.limits.slack_max_mm is None:
        yield _to_the_limit(sums, FaultCode.TRAVEL_WITHOUT_LOAD, fault, math.inf)
    elif case.noticeable_n > case.limits.slack_force_n:
        yield sums.unbounded(FaultCode.LIMIT, fault, "the noise of the force reading exceeds limits.slack_force_n: raise it")
    else:
        beyond = case.stiffness_n_mm * case.limits.slack_max_mm + sums.late_n
        yield sums.row(
            FaultCode.LIMIT,
            fault,
            reference=FREEZING_LOAD,
            beyond=beyond,
            worst=sums.target_n + case.tolerance_n + beyond,
            remark="limits.slack_max_mm at the stated stiffness, wherever the force limit is",
        )
    yield _nothing_shown(sums)


def reads_too_little(sums: RampSums) -> StopDistance:
    """Return the row of a cell that measures a fraction of the load: at least 1/`FASTEST_FACTOR`, or its ramp is detected as too slow.

    At `limits.stiffness_min_n_mm` the load may be smaller than expected by `allowed` N. If the true stiffness is that value, the load
    exceeds its reading by `allowed` at most; with a small fraction, the device runs at up to `FASTEST_FACTOR` times the rate while the
    readings respond late.
    """
    case, fault = sums.case, "the load cell reads only a part of the load"
    if case.limits.stiffness_min_n_mm is None:
        return sums.unbounded(FaultCode.TRAVEL_WITHOUT_LOAD, fault, _STATE_STIFFNESS)
    allowed = owed_allowed_n(case.limits, case.tolerance_n, case.noticeable_n)
    fraction = 1.0 / FASTEST_FACTOR
    hidden = allowed / (1.0 - fraction) + (case.noticeable_n + sums.averaged_n + sums.late_n) / fraction
    past = max(case.tolerance_n, case.noticeable_n)
    near_target_n = sums.target_n + past + allowed + sums.late_n * (1.0 + allowed / max(sums.target_n - sums.start_n, allowed))
    return sums.row(
        FaultCode.TRAVEL_WITHOUT_LOAD,
        fault,
        beyond=max(sums.start_n + hidden, near_target_n) - sums.target_n,
        worst=max(sums.start_n + hidden, near_target_n),
        remark="at limits.stiffness_min_n_mm; n times that stiffness makes the true load up to n times as large",
    )


def _nothing_shown(sums: RampSums) -> StopDistance:
    """Return the row for readings that both do not show the ordered motion."""
    case, fault = sums.case, "neither force nor extension shows the motion"
    slack_mm = case.limits.slack_max_mm
    if slack_mm is None or case.stiffness_n_mm is None:
        max_change = max(sums.rate_n_s * MAX_UNVERIFIED_S, MIN_SHOWN_FACTOR * case.noticeable_n)
        row = _to_the_limit(sums, FaultCode.NO_RESPONSE, fault, max_change)
        return replace(row, remark=f"{STANDSTILL_S:g} s of the ramp where the extension followed it before")
    allowed = max(case.stiffness_n_mm * slack_mm, MIN_SHOWN_FACTOR * case.noticeable_n, sums.soonest_n)
    beyond = allowed + sums.averaged_n + sums.late_n
    worst = sums.target_n + case.tolerance_n + beyond
    return sums.row(FaultCode.NO_RESPONSE, fault, reference="the load at which they freeze", beyond=beyond, worst=worst)


def _to_the_limit(sums: RampSums, code: FaultCode, fault: str, max_change: float) -> StopDistance:
    """Return the row of a rule that allows the hidden load to reach the force limit, or to change by `max_change` N, whichever is less."""
    case = sums.case
    latest = sums.target_n + case.tolerance_n
    min_change = max(sums.soonest_n, MIN_SHOWN_FACTOR * case.noticeable_n)
    extra = case.noticeable_n + sums.averaged_n + sums.late_n
    return sums.row(
        code,
        fault,
        reference=FREEZING_LOAD,
        beyond=max(min(sums.limit_n - sums.start_n, max_change), min_change) + extra,
        worst=max(min(sums.limit_n, latest + max_change), latest + min_change) + extra,
    )
