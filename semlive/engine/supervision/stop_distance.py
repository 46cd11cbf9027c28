"""How far the true load can go before each rule of the supervision stops the load frame, worked out before the run.

Theory of operation
-------------------
A fault begins at the most unfavourable instant of a ramp from `start_n` to `target_n`. The rule that finds it allows a load change (the
tolerance, the unverified load, the headroom below the force limit); until the stop order is at the device pass one polling interval for the
next reading and one more for its answer and the stop order. Each row is the sum, at the ordered rate:

    beyond = what the rule allows + rate * (delay of the averaged readings + 2 poll_s)

Not included, because semlive cannot know them: the way in which the machine decelerates after its stop order, and a device that runs at
more than `FASTEST_FACTOR` times the ordered rate. A second fault at the same time is not considered.

A load cell that reads only a part of the load answers every ramp. Without `limits.stiffness_min_n_mm` nothing but the extension limits
bounds the load then, and the row is open.

Where the readings are right, the force limit bounds the load besides (LIMIT). In load control a device that only loses its link ends the
ramp at its target; in displacement control it ends the short way that was ordered last.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode
from semlive.engine.motion import MAX_APPROACHES
from semlive.engine.supervision.extension_response import owed_allowed_n
from semlive.engine.supervision.load_change import RATE_FACTOR, RATE_WINDOW_S, jump_allowed_n
from semlive.engine.supervision.load_response import ARRIVED_AND_MOVING_S, HEADROOM
from semlive.engine.supervision.ramp_readings import MAX_UNVERIFIED_S, MEAN_READINGS, MIN_READINGS, START_S, verified_within
from semlive.engine.supervision.travel_response import STANDSTILL_S

FASTEST_FACTOR = 20.0
"""A rate that is not kept is assumed to be at most this times the ordered one."""
EXCESS = 1.05
"""The true load may come up to this times the force limit without a warning."""
ANSWER_S = 0.3
"""Longest wait for one answer where the configuration does not state it: the default of the drivers."""
CONNECT_S = 0.3
"""Longest wait for a fresh connection on which a stop is written."""
DEAD_MAN_S = 2.0
"""After so long without a sign of life from control the link thread stops the device."""
STOP_REPORT_S = 1.0
"""A device that still moves so long after its first stop order is reported."""
MIN_SHOWN_FACTOR = 4.0
"""A crosshead that shows less than a quarter of the ordered travel is taken to stand still."""
_STATE_STIFFNESS = (
    "limits.extension_max_mm alone bounds it, where the extension is measured; check the scale of the cell with a known load, and set "
    "limits.stiffness_min_n_mm, or extension_max_mm to what the plan needs"
)
_EARLY_TOLERANCES = 3.0
"""A ramp of at most this many tolerances that does not begin is ordered again instead of being a fault at once."""


@dataclass(frozen=True, slots=True)
class RampCase:
    """One ramp, and what is known of device and link.

    Attributes:
        limits: of the run.
        start_n: load before the ramp.
        target_n: where it goes.
        rate_n_s: how fast, > 0.
        tolerance_n: allowed distance of the load from its target.
        poll_s: from one reading to the next.
        noticeable_n: change of the force reading that is no noise (`ReadingNoise.noticeable`): six standard deviations or two steps.
        settle_s: rest after which a load out of tolerance is judged.
        control: how the device is brought to a load.
        stiffness_n_mm: in displacement control the stated stiffness, N/mm; None if it is not stated.
        answer_s: longest wait for one answer, with repetitions.
        watchdog_s: the device stops by itself when it was not spoken to for so long; None if it does not.
        ahead_s: in displacement control, time for which travel is ordered ahead.
    """

    limits: Limits
    start_n: float
    target_n: float
    rate_n_s: float
    tolerance_n: float
    poll_s: float
    noticeable_n: float = 0.0
    settle_s: float = 5.0
    control: ControlMode = ControlMode.LOAD
    stiffness_n_mm: float | None = None
    answer_s: float = ANSWER_S
    watchdog_s: float | None = None
    ahead_s: float = 0.5

    @property
    def sign(self) -> float:
        """+1 for a ramp upwards, -1 downwards."""
        return math.copysign(1.0, self.target_n - self.start_n)

    @property
    def limit_n(self) -> float:
        """The force limit in the direction of the ramp, N, tension positive."""
        return self.limits.force_max_n if self.sign > 0 else self.limits.force_min_n


@dataclass(frozen=True, slots=True)
class StopDistance:
    """How far a fault can carry the load before it is stopped.

    Attributes:
        code: kind of the fault that is reported.
        fault: what goes wrong, as a clause that follows "if".
        reference: what `beyond_n` counts from.
        beyond_n: largest change of the true load beyond it, N; None if semlive cannot bound it.
        worst_n: the true load farthest in the direction of the ramp, N, tension positive; None if semlive cannot bound it.
        seconds: longest time from the fault to the stop order, to the device's own stop, or, where nothing is bounded, to the alarm, s;
            None if that depends on the machine alone.
        travel_mm: travel at the stated stiffness that belongs to `beyond_n`; None in load control.
        remark: what else has to be known; empty if nothing.
    """

    code: FaultCode
    fault: str
    reference: str
    beyond_n: float | None
    worst_n: float | None
    seconds: float | None
    travel_mm: float | None = None
    remark: str = ""


def noticeable_n(sigma_n: float, resolution_n: float) -> float:
    """Change of the force reading that the supervision takes for noise at most, N, as `RampCase.noticeable_n`.

    Args:
        sigma_n: standard deviation of the reading at rest.
        resolution_n: smallest change that it can show.

    The supervision uses six standard deviations of its own estimate, whose largest value in a long ramp is up to two thirds too large.
    """
    return max(10.0 * sigma_n, 2.0 * resolution_n)


def stop_distances(case: RampCase) -> tuple[StopDistance, ...]:
    """How far the true load can go before a ramp is stopped, for each fault; nothing for a device that a person moves."""
    if case.control is ControlMode.MANUAL or case.start_n == case.target_n:
        return ()
    rows = _Rows(case)
    frozen = rows.travel if case.control is ControlMode.DISPLACEMENT else rows.load
    return (*frozen(), rows.reads_too_little(), *rows.readings_right(), *rows.link(), rows.disobeyed())


def worst(rows: tuple[StopDistance, ...], case: RampCase) -> StopDistance | None:
    """The row with the true load farthest in the direction of the ramp; None if there is none."""
    bounded = [row for row in rows if row.worst_n is not None]
    return max(bounded, key=lambda row: case.sign * (row.worst_n or 0.0), default=None)


def exceeds(row: StopDistance, case: RampCase) -> bool:
    """Whether the true load can come beyond the force limit by more than `EXCESS` allows."""
    return row.worst_n is not None and case.sign * (row.worst_n - case.limit_n) > (EXCESS - 1.0) * abs(case.limit_n)


class _Rows:
    """The sums; loads count along the ramp, so that upwards and downwards are alike."""

    def __init__(self, case: RampCase) -> None:
        self.rate = case.rate_n_s
        # A ramp without noise looks like a channel with steps of one reading's change; that counts up to the tolerance.
        step = min(2.0 * self.rate * case.poll_s, case.tolerance_n)
        case = self.case = replace(case, noticeable_n=max(case.noticeable_n, step))
        self.start, self.target, self.limit = (case.sign * load_n for load_n in (case.start_n, case.target_n, case.limit_n))
        self.late_s = 2.0 * case.poll_s
        self.late = self.rate * self.late_s
        self.averaged = self.rate * MEAN_READINGS * case.poll_s
        # No rule about progress applies sooner.
        self.soonest = self.rate * max(START_S, MIN_READINGS * case.poll_s)
        self.verified = verified_within(self.rate, case.tolerance_n, case.noticeable_n)
        self.near = max(case.tolerance_n, self.verified)

    def row(
        self,
        code: FaultCode,
        fault: str,
        *,
        reference: str = "the target",
        beyond: float,
        worst: float,
        seconds: float | None = None,
        remark: str = "",
    ) -> StopDistance:
        """A row, `worst` counted along the ramp; `seconds` is how long the ramp takes for `beyond` if it is not given."""
        case = self.case
        displacement = case.control is ControlMode.DISPLACEMENT and case.stiffness_n_mm is not None
        travel_mm = beyond / case.stiffness_n_mm if displacement and case.stiffness_n_mm else None
        return StopDistance(
            code, fault, reference, beyond, case.sign * worst, beyond / self.rate if seconds is None else seconds, travel_mm, remark
        )

    def load(self) -> Iterator[StopDistance]:
        """Load control: the reading does not show the load."""
        beyond = self.averaged + max(self.verified, self.soonest) + self.late
        yield self.row(
            FaultCode.NO_RESPONSE,
            "the force reading stands still or saturates on the way",
            reference="the load at which it stands still",
            beyond=beyond,
            worst=max(self.start, self.target - self.near) + beyond,
        )
        latest = self.target + max(self.case.tolerance_n, self.case.noticeable_n)
        longest = self.rate * max(ARRIVED_AND_MOVING_S, self.near / self.rate)
        waits = max(min(longest, HEADROOM * self.limit - latest), self.soonest)
        worst = latest + self.averaged + waits + self.late
        yield self.row(
            FaultCode.MOTION_OVERDUE,
            "the readings stand still near the target and the device goes on",
            beyond=worst - self.target,
            worst=worst,
            remark="less where the extension shows the travel and the stiffness is known from earlier ramps",
        )
        yield self._all_frozen_at_rest()

    def _all_frozen_at_rest(self) -> StopDistance:
        """Everything, the report of motion too, stands still from before the ramp: the engine finds that nothing arrived."""
        case = self.case
        small = abs(case.target_n - case.start_n) <= _EARLY_TOLERANCES * case.tolerance_n
        approaches = 1 + (MAX_APPROACHES if small else 0)
        seconds = approaches * (case.settle_s + 2.0 * case.poll_s) + self.late_s
        return self.row(
            FaultCode.NOT_REACHED if small else FaultCode.STOPPED_EARLY,
            "everything that the device reports, motion included, stands still from before the ramp",
            reference="the load before the ramp",
            beyond=self.rate * seconds,
            worst=self.start + self.rate * seconds,
            seconds=seconds,
        )

    def travel(self) -> Iterator[StopDistance]:
        """Displacement control: travel without load."""
        case, fault = self.case, "the force reading stands still while the crosshead moves"
        if case.stiffness_n_mm is None:
            yield self.unbounded(FaultCode.LIMIT, fault, "the extension limits alone bound it: state the stiffness")
        elif case.limits.slack_max_mm is None:
            yield self._to_the_limit(FaultCode.TRAVEL_WITHOUT_LOAD, fault, math.inf)
        elif case.noticeable_n > case.limits.slack_force_n:
            yield self.unbounded(FaultCode.LIMIT, fault, "the noise of the force reading exceeds limits.slack_force_n: raise it")
        else:
            beyond = case.stiffness_n_mm * case.limits.slack_max_mm + self.late
            yield self.row(
                FaultCode.LIMIT,
                fault,
                reference="the load at which it stands still",
                beyond=beyond,
                worst=self.target + case.tolerance_n + beyond,
                remark="limits.slack_max_mm at the stated stiffness, wherever the force limit is",
            )
        yield self._nothing_shown()

    def reads_too_little(self) -> StopDistance:
        """A cell that reads a part of the load: at least 1/`FASTEST_FACTOR` of it, or its ramp is seen to be too slow.

        At `limits.stiffness_min_n_mm` the travel owes `allowed` N. Where the true stiffness is that one, the load exceeds its reading by
        `allowed` at most; with a small part, the device runs at up to `FASTEST_FACTOR` times the rate while the readings answer late.
        """
        case, fault = self.case, "the load cell reads only a part of the load"
        if case.limits.stiffness_min_n_mm is None:
            return self.unbounded(FaultCode.TRAVEL_WITHOUT_LOAD, fault, _STATE_STIFFNESS)
        allowed = owed_allowed_n(case.limits, case.tolerance_n, case.noticeable_n)
        fraction = 1.0 / FASTEST_FACTOR
        hidden = allowed / (1.0 - fraction) + (case.noticeable_n + self.averaged + self.late) / fraction
        past = max(case.tolerance_n, case.noticeable_n)
        near_target_n = self.target + past + allowed + self.late * (1.0 + allowed / max(self.target - self.start, allowed))
        return self.row(
            FaultCode.TRAVEL_WITHOUT_LOAD,
            fault,
            beyond=max(self.start + hidden, near_target_n) - self.target,
            worst=max(self.start + hidden, near_target_n),
            remark="at limits.stiffness_min_n_mm; n times that stiffness makes the true load up to n times as large",
        )

    def _nothing_shown(self) -> StopDistance:
        case, fault = self.case, "neither force nor extension shows the motion"
        slack_mm = case.limits.slack_max_mm
        if slack_mm is None or case.stiffness_n_mm is None:
            max_change = max(self.rate * MAX_UNVERIFIED_S, MIN_SHOWN_FACTOR * case.noticeable_n)
            row = self._to_the_limit(FaultCode.NO_RESPONSE, fault, max_change)
            return replace(row, remark=f"{STANDSTILL_S:g} s of the ramp where the extension followed it before")
        allowed = max(case.stiffness_n_mm * slack_mm, MIN_SHOWN_FACTOR * case.noticeable_n, self.soonest)
        beyond = allowed + self.averaged + self.late
        worst = self.target + case.tolerance_n + beyond
        return self.row(FaultCode.NO_RESPONSE, fault, reference="the load at which they stand still", beyond=beyond, worst=worst)

    def _to_the_limit(self, code: FaultCode, fault: str, max_change: float) -> StopDistance:
        """A rule that lets the hidden load come up to the force limit, or change by `most`, whichever is less."""
        case = self.case
        latest = self.target + case.tolerance_n
        min_change = max(self.soonest, MIN_SHOWN_FACTOR * case.noticeable_n)
        extra = case.noticeable_n + self.averaged + self.late
        return self.row(
            code,
            fault,
            reference="the load at which it stands still",
            beyond=max(min(self.limit - self.start, max_change), min_change) + extra,
            worst=max(min(self.limit, latest + max_change), latest + min_change) + extra,
        )

    def readings_right(self) -> Iterator[StopDistance]:
        """The readings show the load, or are wrong by a bounded amount."""
        case = self.case
        wide = max(case.tolerance_n, 1.5 * case.noticeable_n)
        past = max(case.tolerance_n, case.noticeable_n)
        over = min(self.target + past, self.limit)
        yield self.row(FaultCode.OVERSHOOT, "the device does not stop at the target", beyond=past + self.late, worst=over + self.late)
        fast = FASTEST_FACTOR * self.rate
        explained = (RATE_FACTOR - 1.0) * self.rate * RATE_WINDOW_S + RATE_FACTOR * self.late + wide
        found_s = explained / (fast - self.rate)
        yield self.row(
            FaultCode.RATE_NOT_KEPT,
            f"the device runs at {FASTEST_FACTOR:g} times the ordered rate",
            reference="the load at which it begins",
            beyond=fast * (found_s + self.late_s),
            worst=over + fast * self.late_s,
            seconds=found_s + self.late_s,
            remark="a faster device goes farther: set a speed limit at the machine",
        )
        yield self.row(
            FaultCode.WRONG_DIRECTION,
            "the force reading has the wrong sign, or the drive the wrong direction",
            reference="the load before the ramp",
            beyond=wide + self.late,
            worst=self.start + wide + self.late,
        )
        yield self._undetected_jump()
        yield self.row(
            FaultCode.LIMIT, "the load passes the force limit", reference="the force limit", beyond=self.late, worst=self.limit + self.late
        )
        yield self.row(
            FaultCode.MOVED_AT_REST,
            "the load frame moves in a hold, at the ramp's rate",
            reference="the load that is held",
            beyond=case.tolerance_n + 1.5 * self.late,
            worst=min(self.target + case.tolerance_n, self.limit) + 1.5 * self.late,
        )

    def _undetected_jump(self) -> StopDistance:
        """A reading that drops by less than a jump is believed, and the device brings the reading to the target."""
        case, drop_n = self.case, self.case.limits.force_drop_max_n
        jump = jump_allowed_n(case.limits, case.tolerance_n, case.noticeable_n) + 2.0 * self.late
        wide = drop_n is not None and drop_n > jump
        unseen = max(jump, drop_n or 0.0)
        if case.control is ControlMode.DISPLACEMENT:
            found = max(self.limit - self.target, self.soonest) if case.limits.slack_max_mm is None else math.inf
        else:
            found = self.near + max(self.verified, self.soonest)  # then the reading has not been seen to rise again
        beyond = unseen + case.tolerance_n if unseen <= found else found + case.tolerance_n + self.averaged + self.late
        return self.row(
            FaultCode.LOAD_JUMP,
            f"the force reading drops by up to {unseen:.3g} N, which is no jump yet, and stays wrong",
            beyond=beyond,
            worst=self.target + beyond,
            remark="limits.force_drop_max_n sets what counts as a jump" if wide else "",
        )

    def link(self) -> Iterator[StopDistance]:
        """Link and control: a ramp that nobody looks at ends at its target, or with the travel that was ordered last."""
        case = self.case
        silent_s = case.poll_s + case.answer_s + CONNECT_S
        remaining_n = self.target - self.start
        reference, device_end = "the last reading", "the device ends the ramp at its target by itself"
        if case.control is ControlMode.DISPLACEMENT:
            remaining_n, device_end = (
                min(remaining_n, self.rate * case.ahead_s),
                "the device ends the travel that was ordered last by itself, which semlive cannot verify",
            )
        yield self.row(
            FaultCode.LINK_LOST,
            "the device does not answer any more, but takes orders",
            reference=reference,
            beyond=min(self.rate * silent_s, remaining_n),
            worst=self.target,
            seconds=silent_s,
        )
        own_s = None if case.watchdog_s is None else case.watchdog_s + case.poll_s
        yield self.row(
            FaultCode.LINK_LOST,
            "the link is cut and no stop order arrives, or the computer fails",
            reference=reference,
            beyond=remaining_n if own_s is None else min(self.rate * own_s, remaining_n),
            worst=self.target,
            seconds=remaining_n / self.rate if own_s is None else min(own_s, remaining_n / self.rate),
            remark=device_end if own_s is None else f"the device's own watchdog stops it after {case.watchdog_s:g} s; {device_end}",
        )
        dead_s = DEAD_MAN_S + case.poll_s
        yield self.row(
            FaultCode.CONTROL_LOST,
            "the control process of semlive does not run on",
            reference="the load at that instant",
            beyond=min(self.rate * dead_s, self.target - self.start),
            worst=self.target,
            seconds=dead_s,
            remark="the link thread goes on supervising the ramp",
        )

    def disobeyed(self) -> StopDistance:
        """Nothing that semlive orders bounds this one."""
        report_s = STOP_REPORT_S + self.case.poll_s
        what = f"the stop order is repeated and reported after {report_s:.2g} s: press the emergency stop of the machine at once"
        return StopDistance(
            FaultCode.STOP_NOT_OBEYED, "the device does not obey its stop orders", "the first stop order", None, None, report_s, None, what
        )

    def unbounded(self, code: FaultCode, fault: str, remark: str) -> StopDistance:
        """A row that the configuration leaves open."""
        return StopDistance(code, fault, "the load at which it stands still", None, None, None, None, remark)
