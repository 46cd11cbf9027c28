"""Input and result of the stop distances: a ramp with its device and link, and how far a fault can carry the load."""

from __future__ import annotations

import math
from dataclasses import dataclass

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode

FASTEST_FACTOR = 20.0
"""Largest assumed ratio of a wrong rate to the ordered rate."""
EXCESS = 1.05
"""Largest ratio of the true load to the force limit without a warning."""
ANSWER_S = 0.3
"""Longest wait for one answer, s, where the configuration does not state it: the default of the drivers."""
CONNECT_S = 0.3
"""Longest wait for a new connection on which a stop is written, s."""
DEAD_MAN_S = 2.0
"""Time without a keep-alive signal of control after which the link thread stops the device, s."""
STOP_REPORT_S = 1.0
"""Time after the first stop order from which a device that still moves is reported, s."""
MIN_SHOWN_FACTOR = 4.0
"""Ordered travel over the smallest observed travel that counts as motion of the crosshead."""


@dataclass(frozen=True, slots=True)
class RampCase:
    """One ramp, with properties of its device and link.

    Attributes:
        limits: soft limits of the run.
        start_n: load before the ramp, N.
        target_n: target load, N.
        rate_n_s: rate of the load, N/s, > 0.
        tolerance_n: allowed deviation of the load from its target, N.
        poll_s: interval between readings, s.
        noticeable_n: smallest change of the force reading that exceeds the noise (`ReadingNoise.noticeable`), N: six standard deviations
            or two steps.
        settle_s: time at rest after which a load out of tolerance is evaluated, s.
        control: control mode of the device.
        stiffness_n_mm: in displacement control the stated stiffness, N/mm; None if it is not stated.
        answer_s: longest wait for one answer with its repetitions, s.
        watchdog_s: time without a request after which the device stops by itself, s; None if it does not.
        ahead_s: in displacement control, time for which travel is ordered ahead, s.
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
        code: kind of the reported fault.
        fault: what goes wrong, as a clause that follows "if".
        reference: load from which `beyond_n` counts.
        beyond_n: largest change of the true load beyond the reference, N; None if semlive cannot bound it.
        worst_n: the true load farthest in the direction of the ramp, N, tension positive; None if semlive cannot bound it.
        seconds: longest time from the fault to the stop order, to the device's own stop, or, without a bound, to the alarm, s; None if
            that depends on the machine alone.
        travel_mm: travel for `beyond_n` at the stated stiffness, mm; None in load control.
        remark: conditions of the row; empty without any.
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
    """Return the largest change of the force reading that the supervision attributes to noise, N, as `RampCase.noticeable_n`.

    Args:
        sigma_n: standard deviation of the reading at rest, N.
        resolution_n: resolution of the reading, N.

    The supervision uses six standard deviations of its own estimate, whose largest value in a long ramp is up to two thirds too large.
    """
    return max(10.0 * sigma_n, 2.0 * resolution_n)


def worst(rows: tuple[StopDistance, ...], case: RampCase) -> StopDistance | None:
    """Return the row with the true load farthest in the direction of the ramp; None if there is none."""
    bounded = [row for row in rows if row.worst_n is not None]
    return max(bounded, key=lambda row: case.sign * (row.worst_n or 0.0), default=None)


def exceeds(row: StopDistance, case: RampCase) -> bool:
    """Return whether the true load can come beyond the force limit by more than `EXCESS` allows."""
    return row.worst_n is not None and case.sign * (row.worst_n - case.limit_n) > (EXCESS - 1.0) * abs(case.limit_n)
