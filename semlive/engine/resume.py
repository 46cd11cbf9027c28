"""A run that was interrupted: what its log tells of it, and what is asked before it goes on.

Loading is path dependent, so nothing is rewound: the steps whose pairs stand in the log are done, and the step that was under way is
entered again from its motion, with its hold in full. A frame of an unfinished pair is not believed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.experiment import Plan, Step
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, MotionState, StageSample
from semlive.data.pair import PairDecision
from semlive.engine.events import CalibrationAssessed, DriftForecastUpdated, FieldOfViewMeasured
from semlive.engine.supervision.ramp_supervision import Finding
from semlive.errors import BadInput


@dataclass(frozen=True, slots=True)
class RampOrder:
    """A ramp that was ordered: to `force_n` (N) at `rate_n_s` (N/s)."""

    force_n: float
    rate_n_s: float


@dataclass(frozen=True, slots=True)
class InterruptedRun:
    """What is known of a run up to where it broke off.

    Attributes:
        completed_pairs: its pairs, in order from pair 0; their steps are those that were commanded, corrections of the stage included.
        origin_um: the stage's reading when the run began, None if there was none.
        load: last reading of the load frame.
        position: last reading of the stage.
        field_of_view: where the field of the newest correlated pair was.
        start_sigma_s: how well the start of the last frame was known, None before the first.
        drift_forecast: how fast the newest estimate expected the drift to be.
        calibration_assessment: what the newest estimate said of the calibration.
        ramping: motion of the step had been ordered, and its end was not seen.
        ordered: the last ramp that was ordered, None before the first.
    """

    completed_pairs: tuple[PairDecision, ...] = ()
    origin_um: tuple[float, float] | None = None
    load: LoadSample | None = None
    position: StageSample | None = None
    field_of_view: FieldOfViewMeasured | None = None
    start_sigma_s: float | None = None
    drift_forecast: DriftForecastUpdated | None = None
    calibration_assessment: CalibrationAssessed | None = None
    ramping: bool = False
    ordered: RampOrder | None = None

    def all_done(self, plan: Plan) -> bool:
        """Whether nothing of a plan is left to do."""
        return len(self.completed_pairs) == len(self.steps_of(plan).steps)

    def steps_of(self, plan: Plan) -> Plan:
        """The plan with the steps that are done as they were done.

        Raises:
            BadInput: if the pairs are not the plan's first ones, each once.
        """
        numbers, planned = [one.pair for one in self.completed_pairs], sum(not one.step.warm_up for one in self.completed_pairs)
        if numbers != list(range(len(numbers))) or planned > len(plan.steps):
            raise BadInput(
                f"the log holds the pairs {numbers} of a plan of {len(plan.steps)} steps; pairs are missing or strange, so begin a new run"
            )
        left = (replace(step, step=number) for number, step in enumerate(plan.steps[planned:], start=len(numbers)))
        return replace(plan, steps=(*(one.step for one in self.completed_pairs), *left))


def order_code(sample: LoadSample) -> FaultCode:
    """The code of a reading whose `order_changed` is set."""
    return FaultCode.DEVICE_RESTARTED if sample.orders_cleared else FaultCode.FOREIGN_ORDER


def device_changes(
    before: InterruptedRun, step: Step, tolerance_n: float, load: LoadSample | None, position: StageSample | None
) -> Finding | None:
    """How the devices differ from what the log left, or None: orders in the device, load, extension, position of the stage.

    A load that was on its way may have arrived meanwhile, or stopped anywhere on it; a stage that moved is where it happens to be.

    Args:
        before: what the log told.
        step: the step that is entered again.
        tolerance_n: how far a load may have crept.
        load: as read now.
        position: as read now.
    """
    then = before.load
    if load is not None and load.order_changed is not None:
        return Finding(order_code(load), load.order_changed)
    if then is not None and load is not None:
        ends_n = [then.force_n, then.target_n if then.motion is MotionState.MOVING else then.force_n]
        if before.ramping and step.load_n is not None:
            ends_n.append(step.load_n)
        if not min(ends_n) - tolerance_n <= load.force_n <= max(ends_n) + tolerance_n:
            text = f"the load is {load.force_n:.1f} N now, and was {then.force_n:.1f} N when it was last read"
            return Finding(FaultCode.MOVED_AT_REST, text)
        if _extension_changed(then, load, before, step):
            text = (
                f"the extension is {load.extension_mm:.4f} mm now, and was {then.extension_mm:.4f} mm when it was last read: "
                "the crosshead was moved, or the zero of the extension was lost"
            )
            return Finding(FaultCode.MOVED_AT_REST, text)
    at = before.position
    if at is not None and position is not None and at.motion is MotionState.STOPPED:
        x_um, y_um = before.origin_um or (at.x_um, at.y_um)
        places = ((at.x_um, at.y_um), (x_um + step.shift_um[0], y_um + step.shift_um[1]))
        if not any(_near(place, position, _STAGE_UM) for place in places):
            text = (
                f"the stage is at ({position.x_um:.1f}, {position.y_um:.1f}) um now, "
                f"and was at ({at.x_um:.1f}, {at.y_um:.1f}) um when it was last read"
            )
            return Finding(FaultCode.MOVED_AT_REST, text)
    return None


def _extension_changed(then: LoadSample, now: LoadSample, before: InterruptedRun, step: Step) -> bool:
    """Whether the crosshead is not where it was; one that was on its way may be anywhere further in that direction."""
    change_mm = now.extension_mm - then.extension_mm
    goal_n = step.load_n if before.ramping and step.load_n is not None else then.target_n
    on_its_way = before.ramping or then.motion is MotionState.MOVING
    if on_its_way and change_mm * (goal_n - then.force_n) > 0.0:
        return False
    return abs(change_mm) > _EXTENSION_MM


_EXTENSION_MM = 0.01
"""A change of the extension beyond this is no noise, creep or thermal expansion of a held crosshead, which are a few um."""
_STAGE_UM = 20.0
"""A stage further from where it was than this was moved, or forgot its zero; backlash and creep are a few um."""


def _near(place: tuple[float, float], position: StageSample, within_um: float) -> bool:
    return max(abs(position.x_um - place[0]), abs(position.y_um - place[1])) <= within_um
