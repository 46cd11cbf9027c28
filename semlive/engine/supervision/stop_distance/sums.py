"""Sums that the rows of the stop distances share; loads count along the ramp, so that ramps upwards and downwards are equal."""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode
from semlive.engine.supervision.ramp_readings import MEAN_READINGS, MIN_READINGS, START_S, verified_within
from semlive.engine.supervision.stop_distance.case import RampCase, StopDistance

FREEZING_LOAD = "the load at which it freezes"
"""Reference of the rows of a frozen reading."""


@dataclass(frozen=True, slots=True)
class RampSums:
    """Load changes and times of one ramp.

    Attributes:
        case: the ramp; its `noticeable_n` includes the change of one reading of a ramp without noise.
        rate_n_s: rate of the ramp, N/s.
        start_n: load before the ramp, N.
        target_n: target load, N.
        limit_n: force limit in the direction of the ramp, N.
        late_s: time from the reading that shows a fault until the stop order is at the device, s.
        late_n: load change in that time, N.
        averaged_n: load change while the readings are averaged, N.
        soonest_n: load change before the first rule of missing progress applies, N.
        verified_n: largest load change that may stay unverified, N.
        near_n: distance from the target within which a device may creep, N.
    """

    case: RampCase
    rate_n_s: float
    start_n: float
    target_n: float
    limit_n: float
    late_s: float
    late_n: float
    averaged_n: float
    soonest_n: float
    verified_n: float
    near_n: float

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
        """Return a row.

        Args:
            code: kind of the fault.
            fault: what goes wrong, as a clause that follows "if".
            reference: load from which `beyond` counts.
            beyond: largest change of the true load beyond the reference, N.
            worst: the true load farthest along the ramp, N, counted along the ramp.
            seconds: time of the row, s; None: how long the ramp takes for `beyond`.
            remark: what else has to be known.
        """
        case = self.case
        displacement = case.control is ControlMode.DISPLACEMENT and case.stiffness_n_mm is not None
        travel_mm = beyond / case.stiffness_n_mm if displacement and case.stiffness_n_mm else None
        return StopDistance(
            code, fault, reference, beyond, case.sign * worst, beyond / self.rate_n_s if seconds is None else seconds, travel_mm, remark
        )

    def unbounded(self, code: FaultCode, fault: str, remark: str) -> StopDistance:
        """Return a row without a bound, for a configuration that does not bound the load."""
        return StopDistance(code, fault, FREEZING_LOAD, None, None, None, None, remark)


def ramp_sums(case: RampCase) -> RampSums:
    """Return the sums of a ramp."""
    rate = case.rate_n_s
    # A ramp without noise looks like a channel with steps of one reading's change; that counts up to the tolerance.
    step = min(2.0 * rate * case.poll_s, case.tolerance_n)
    case = replace(case, noticeable_n=max(case.noticeable_n, step))
    start_n, target_n, limit_n = (case.sign * load_n for load_n in (case.start_n, case.target_n, case.limit_n))
    late_s = 2.0 * case.poll_s
    verified_n = verified_within(rate, case.tolerance_n, case.noticeable_n)
    return RampSums(
        case,
        rate,
        start_n,
        target_n,
        limit_n,
        late_s,
        late_n=rate * late_s,
        averaged_n=rate * MEAN_READINGS * case.poll_s,
        # No rule about progress applies sooner.
        soonest_n=rate * max(START_S, MIN_READINGS * case.poll_s),
        verified_n=verified_n,
        near_n=max(case.tolerance_n, verified_n),
    )
