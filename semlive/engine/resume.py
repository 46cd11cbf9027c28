"""Interrupted runs: the state that the log contains, and the checks before the run is resumed.

Loading is path dependent, so no step is undone. The steps whose pairs are stored in the log are complete. The interrupted step begins again
with its motion and its full hold. Frames of an incomplete pair are not used.
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
    """State of a run at its interruption, from the log.

    Attributes:
        completed_pairs: completed pairs, in order from pair 0; their steps are the commanded ones, with recentring.
        origin_um: reading of the stage when the run began; None without a stage.
        load: last reading of the load frame.
        position: last reading of the stage.
        field_of_view: field of view of the newest correlated pair.
        start_sigma_s: standard uncertainty of the start time of the last frame, s; None before the first.
        drift_forecast: drift forecast of the newest estimate.
        calibration_assessment: assessment of the calibration by the newest estimate.
        ramping: motion of the step had been ordered, and its end was not recorded.
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
        """Whether all steps of a plan are complete."""
        return len(self.completed_pairs) == len(self.steps_of(plan).steps)

    def steps_of(self, plan: Plan) -> Plan:
        """Return the plan with the completed steps as they were executed.

        Raises:
            BadInput: if the completed pairs are not the first pairs of the plan, each once.
        """
        numbers, planned = [pair.pair for pair in self.completed_pairs], sum(not pair.step.warm_up for pair in self.completed_pairs)
        if numbers != list(range(len(numbers))) or planned > len(plan.steps):
            raise BadInput(
                f"the log holds the pairs {numbers} of a plan of {len(plan.steps)} steps; pairs are missing or strange, so begin a new run"
            )
        remaining = (replace(step, step=number) for number, step in enumerate(plan.steps[planned:], start=len(numbers)))
        return replace(plan, steps=(*(pair.step for pair in self.completed_pairs), *remaining))


def order_code(sample: LoadSample) -> FaultCode:
    """Return the fault code for a reading with `order_changed` set."""
    return FaultCode.DEVICE_RESTARTED if sample.orders_cleared else FaultCode.FOREIGN_ORDER


def device_changes(
    interrupted_run: InterruptedRun, step: Step, tolerance_n: float, load: LoadSample | None, position: StageSample | None
) -> Finding | None:
    """Compare the devices with the log: orders in the device, load, extension, stage position. Return the first difference, or None.

    A load that was being ramped may be anywhere between its last reading and its target. A stage that was moving is not checked.

    Args:
        interrupted_run: state of the run at its interruption.
        step: the step that is repeated.
        tolerance_n: allowed creep of the load, N.
        load: present reading of the load frame; None without one.
        position: present reading of the stage; None without one.
    """
    last_load = interrupted_run.load
    if load is not None and load.order_changed is not None:
        return Finding(order_code(load), load.order_changed)
    if last_load is not None and load is not None:
        bounds_n = [last_load.force_n, last_load.target_n if last_load.motion is MotionState.MOVING else last_load.force_n]
        if interrupted_run.ramping and step.load_n is not None:
            bounds_n.append(step.load_n)
        if not min(bounds_n) - tolerance_n <= load.force_n <= max(bounds_n) + tolerance_n:
            text = f"the load is {load.force_n:.1f} N now, and was {last_load.force_n:.1f} N when it was last read"
            return Finding(FaultCode.MOVED_AT_REST, text)
        if _extension_changed(last_load, load, interrupted_run, step):
            text = (
                f"the extension is {load.extension_mm:.4f} mm now, and was {last_load.extension_mm:.4f} mm when it was last read: "
                "the crosshead was moved, or the zero of the extension was lost"
            )
            return Finding(FaultCode.MOVED_AT_REST, text)
    last_position = interrupted_run.position
    if last_position is not None and position is not None and last_position.motion is MotionState.STOPPED:
        x_um, y_um = interrupted_run.origin_um or (last_position.x_um, last_position.y_um)
        expected_um = ((last_position.x_um, last_position.y_um), (x_um + step.shift_um[0], y_um + step.shift_um[1]))
        if not any(_near(point_um, position, _MAX_STAGE_CHANGE_UM) for point_um in expected_um):
            text = (
                f"the stage is at ({position.x_um:.1f}, {position.y_um:.1f}) um now, "
                f"and was at ({last_position.x_um:.1f}, {last_position.y_um:.1f}) um when it was last read"
            )
            return Finding(FaultCode.MOVED_AT_REST, text)
    return None


def _extension_changed(last: LoadSample, current: LoadSample, interrupted_run: InterruptedRun, step: Step) -> bool:
    """Whether the crosshead was moved. If it was moving at the interruption, any travel in that direction is accepted."""
    change_mm = current.extension_mm - last.extension_mm
    target_n = step.load_n if interrupted_run.ramping and step.load_n is not None else last.target_n
    moving = interrupted_run.ramping or last.motion is MotionState.MOVING
    if moving and change_mm * (target_n - last.force_n) > 0.0:
        return False
    return abs(change_mm) > _MAX_EXTENSION_CHANGE_MM


_MAX_EXTENSION_CHANGE_MM = 0.01
"""Largest change of the extension by noise, creep and thermal expansion of a held crosshead, which are a few um."""
_MAX_STAGE_CHANGE_UM = 20.0
"""Largest change of the stage position; beyond it, the stage was moved or lost its zero. Backlash and creep are a few um."""


def _near(point_um: tuple[float, float], position: StageSample, within_um: float) -> bool:
    return max(abs(position.x_um - point_um[0]), abs(position.y_um - point_um[1])) <= within_um
