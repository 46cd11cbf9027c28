"""The field of view kept where the plan wants it: what drift and the specimen's own motion carried away is taken back.

At x10,000 the beam drifts by a tenth of the field in an hour. A field that is brought back shows later frames at nearly the scan
addresses of frame 0, where most of the distortion falls out of their difference: on the simulated experiment the correction's share
of strain under load fell from 5.7e-5 to 2e-5.
"""

from __future__ import annotations

from dataclasses import replace

from semlive.data.experiment import Limits, Plan
from semlive.engine.events import FieldOfViewMeasured

_DIGITS = 4  # of a correction in um, so that one of nothing moves nothing


def recentre(plan: Plan, limits: Limits, index: int, seen: FieldOfViewMeasured | None) -> Plan:
    """The plan with the stage position of one step corrected for where the field of an earlier pair was.

    The correction is counted from that pair's own, so it does not matter how many steps ago that was. It never leads beyond the
    limit of the stage; what the plan itself asks beyond it stays, and is refused where motion is ordered.

    Args:
        plan: the experiment.
        limits: soft limits.
        index: of the step that begins.
        seen: the newest pair whose field is known; None leaves the plan as it is, as does a plan without `recentring`.
    """
    rule, step = plan.recentring, plan.steps[index]
    if rule is None or seen is None or not 0 <= seen.pair < index:
        return plan
    then, first = plan.steps[seen.pair], plan.steps[0]
    astray_px = [moved - (at - began) for moved, at, began in zip(seen.shift_px, then.shift_px, first.shift_px, strict=True)]
    if max(map(abs, astray_px)) <= rule.threshold_px:
        astray_px = [0.0, 0.0]
    x_um, y_um = (
        _within(planned_um + round(then_um - (then_px + off_px) * rule.um_per_px, _DIGITS), max(limits.stage_travel_um, abs(planned_um)))
        for planned_um, then_um, then_px, off_px in zip(step.shift_um, then.shift_um, then.shift_px, astray_px, strict=True)
    )
    return replace(plan, steps=(*plan.steps[:index], replace(step, shift_um=(x_um, y_um)), *plan.steps[index + 1 :]))


def _within(to_um: float, limit_um: float) -> float:
    return min(max(to_um, -limit_um), limit_um)
