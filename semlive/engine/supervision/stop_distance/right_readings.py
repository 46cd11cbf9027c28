"""Stop distances where the readings show the load, or are wrong by a bounded amount, and where link, control or stop fail."""

from __future__ import annotations

import math
from collections.abc import Iterator

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode
from semlive.engine.supervision.load_change import RATE_FACTOR, RATE_WINDOW_S, jump_allowed_n
from semlive.engine.supervision.stop_distance.case import CONNECT_S, DEAD_MAN_S, FASTEST_FACTOR, STOP_REPORT_S, StopDistance
from semlive.engine.supervision.stop_distance.sums import RampSums


def readings_right(sums: RampSums) -> Iterator[StopDistance]:
    """Yield the rows in which the readings show the load, or are wrong by a bounded amount."""
    case = sums.case
    wide = max(case.tolerance_n, 1.5 * case.noticeable_n)
    past = max(case.tolerance_n, case.noticeable_n)
    over = min(sums.target_n + past, sums.limit_n)
    yield sums.row(FaultCode.OVERSHOOT, "the device does not stop at the target", beyond=past + sums.late_n, worst=over + sums.late_n)
    fast = FASTEST_FACTOR * sums.rate_n_s
    explained = (RATE_FACTOR - 1.0) * sums.rate_n_s * RATE_WINDOW_S + RATE_FACTOR * sums.late_n + wide
    detected_s = explained / (fast - sums.rate_n_s)
    yield sums.row(
        FaultCode.RATE_NOT_KEPT,
        f"the device runs at {FASTEST_FACTOR:g} times the ordered rate",
        reference="the load at which it begins",
        beyond=fast * (detected_s + sums.late_s),
        worst=over + fast * sums.late_s,
        seconds=detected_s + sums.late_s,
        remark="a faster device goes farther: set a speed limit at the machine",
    )
    yield sums.row(
        FaultCode.WRONG_DIRECTION,
        "the force reading has the wrong sign, or the drive the wrong direction",
        reference="the load before the ramp",
        beyond=wide + sums.late_n,
        worst=sums.start_n + wide + sums.late_n,
    )
    yield _undetected_jump(sums)
    yield sums.row(
        FaultCode.LIMIT,
        "the load passes the force limit",
        reference="the force limit",
        beyond=sums.late_n,
        worst=sums.limit_n + sums.late_n,
    )
    yield sums.row(
        FaultCode.MOVED_AT_REST,
        "the load frame moves in a hold, at the ramp's rate",
        reference="the load that is held",
        beyond=case.tolerance_n + 1.5 * sums.late_n,
        worst=min(sums.target_n + case.tolerance_n, sums.limit_n) + 1.5 * sums.late_n,
    )


def _undetected_jump(sums: RampSums) -> StopDistance:
    """Return the row of a reading that drops by less than a jump: it is accepted, and the device brings the reading to the target."""
    case, drop_n = sums.case, sums.case.limits.force_drop_max_n
    jump = jump_allowed_n(case.limits, case.tolerance_n, case.noticeable_n) + 2.0 * sums.late_n
    wide = drop_n is not None and drop_n > jump
    undetected_n = max(jump, drop_n or 0.0)
    if case.control is ControlMode.DISPLACEMENT:
        detectable_n = max(sums.limit_n - sums.target_n, sums.soonest_n) if case.limits.slack_max_mm is None else math.inf
    else:
        detectable_n = sums.near_n + max(sums.verified_n, sums.soonest_n)  # until then the reading has not risen again
    beyond = (
        undetected_n + case.tolerance_n if undetected_n <= detectable_n else detectable_n + case.tolerance_n + sums.averaged_n + sums.late_n
    )
    return sums.row(
        FaultCode.LOAD_JUMP,
        f"the force reading drops by up to {undetected_n:.3g} N, which is no jump yet, and stays wrong",
        beyond=beyond,
        worst=sums.target_n + beyond,
        remark="limits.force_drop_max_n sets what counts as a jump" if wide else "",
    )


def link(sums: RampSums) -> Iterator[StopDistance]:
    """Yield the rows of link and control: an unsupervised ramp ends at its target, or with the travel that was ordered last."""
    case = sums.case
    silent_s = case.poll_s + case.answer_s + CONNECT_S
    remaining_n = sums.target_n - sums.start_n
    reference, device_end = "the last reading", "the device ends the ramp at its target by itself"
    if case.control is ControlMode.DISPLACEMENT:
        remaining_n, device_end = (
            min(remaining_n, sums.rate_n_s * case.ahead_s),
            "the device ends the travel that was ordered last by itself, which semlive cannot verify",
        )
    yield sums.row(
        FaultCode.LINK_LOST,
        "the device does not answer any more, but takes orders",
        reference=reference,
        beyond=min(sums.rate_n_s * silent_s, remaining_n),
        worst=sums.target_n,
        seconds=silent_s,
    )
    own_s = None if case.watchdog_s is None else case.watchdog_s + case.poll_s
    yield sums.row(
        FaultCode.LINK_LOST,
        "the link is cut and no stop order arrives, or the computer fails",
        reference=reference,
        beyond=remaining_n if own_s is None else min(sums.rate_n_s * own_s, remaining_n),
        worst=sums.target_n,
        seconds=remaining_n / sums.rate_n_s if own_s is None else min(own_s, remaining_n / sums.rate_n_s),
        remark=device_end if own_s is None else f"the device's own watchdog stops it after {case.watchdog_s:g} s; {device_end}",
    )
    dead_s = DEAD_MAN_S + case.poll_s
    yield sums.row(
        FaultCode.CONTROL_LOST,
        "the control process of semlive is suspended",
        reference="the load at that instant",
        beyond=min(sums.rate_n_s * dead_s, sums.target_n - sums.start_n),
        worst=sums.target_n,
        seconds=dead_s,
        remark="the link thread continues to supervise the ramp",
    )


def disobeyed(sums: RampSums) -> StopDistance:
    """Return the row of a device that does not obey its stop orders; no order bounds it."""
    report_s = STOP_REPORT_S + sums.case.poll_s
    what = f"the stop order is repeated and reported after {report_s:.2g} s: press the emergency stop of the machine at once"
    return StopDistance(
        FaultCode.STOP_NOT_OBEYED, "the device does not obey its stop orders", "the first stop order", None, None, report_s, None, what
    )
