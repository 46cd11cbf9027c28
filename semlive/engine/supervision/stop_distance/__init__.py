"""How far the true load can go before each rule of the supervision stops the load frame, calculated before the run.

Theory of operation
-------------------
A fault begins at the most unfavourable instant of a ramp from `start_n` to `target_n`. The rule that detects it allows a load change (the
tolerance, the unverified load, the headroom below the force limit). The next reading comes one polling interval later at most, and its
answer and the stop order take at most one more. Each row is the sum, at the ordered rate:

    beyond = load change that the rule allows + rate * (delay of the averaged readings + 2 poll_s)

Two quantities are not included, because semlive cannot know them: the deceleration of the machine after its stop order, and the rate of a
device that runs at more than `FASTEST_FACTOR` times the ordered rate. A second fault at the same time is not considered.

A load cell that measures only a fraction of the load answers every ramp. Without `limits.stiffness_min_n_mm` only the extension limits
bound the load then, and the row has no bound.

Where the readings are right, the force limit also bounds the load (LIMIT). In load control a device that only loses its link ends the
ramp at its target; in displacement control it ends the short travel that was ordered last.

`case` holds input and result, `sums` the quantities that the rows share, `wrong_readings` and `right_readings` the rows.
"""

from semlive.data.loading import ControlMode
from semlive.engine.supervision.stop_distance.case import (
    ANSWER_S,
    CONNECT_S,
    DEAD_MAN_S,
    EXCESS,
    FASTEST_FACTOR,
    STOP_REPORT_S,
    RampCase,
    StopDistance,
    exceeds,
    noticeable_n,
    worst,
)
from semlive.engine.supervision.stop_distance.right_readings import disobeyed, link, readings_right
from semlive.engine.supervision.stop_distance.sums import ramp_sums
from semlive.engine.supervision.stop_distance.wrong_readings import load, reads_too_little, travel

__all__ = [
    "ANSWER_S",
    "CONNECT_S",
    "DEAD_MAN_S",
    "EXCESS",
    "FASTEST_FACTOR",
    "STOP_REPORT_S",
    "RampCase",
    "StopDistance",
    "exceeds",
    "noticeable_n",
    "stop_distances",
    "worst",
]


def stop_distances(case: RampCase) -> tuple[StopDistance, ...]:
    """Return how far the true load can go before a ramp is stopped, for each fault; empty for a manually operated device."""
    if case.control is ControlMode.MANUAL or case.start_n == case.target_n:
        return ()
    sums = ramp_sums(case)
    frozen = travel if case.control is ControlMode.DISPLACEMENT else load
    return (*frozen(sums), reads_too_little(sums), *readings_right(sums), *link(sums), disobeyed(sums))
