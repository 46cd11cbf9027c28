"""Deviation of load and stage from their targets, and the fault of a device that moved while no motion was ordered."""

from __future__ import annotations

import math

from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, MotionState
from semlive.engine.context import StepContext
from semlive.engine.state import EngineState
from semlive.engine.states import Cause, State
from semlive.engine.supervision.unloading import ramp_sign


def stage_target_um(state: EngineState) -> tuple[float, float]:
    """Return the target of the stage in its own coordinates, um."""
    x0, y0 = state.devices.origin_um or (0.0, 0.0)
    dx, dy = state.step.shift_um
    return x0 + dx, y0 + dy


def load_target_n(state: EngineState) -> float | None:
    """Return the load to hold, N: that of the step, or the load when settling began."""
    return state.hold.load_n if state.step.load_n is None else state.step.load_n


def load_error_n(state: EngineState) -> float:
    """Return the deviation of the load from its target, N; 0 without a load frame, NaN before the first sample."""
    target = load_target_n(state)
    if state.devices.load_frame is None:
        return 0.0
    if state.devices.load is None or target is None:
        return math.nan
    return state.devices.load.force_n - target


def stage_error_um(state: EngineState) -> float:
    """Return the larger deviation of the stage from its target along x and y, um; 0 without a stage, NaN before the first sample."""
    if state.devices.stage is None:
        return 0.0
    if state.devices.position is None:
        return math.nan
    x, y = stage_target_um(state)
    dx_um, dy_um = state.devices.position.x_um - x, state.devices.position.y_um - y
    return math.nan if math.isnan(dx_um + dy_um) else max(abs(dx_um), abs(dy_um))


def load_within(state: EngineState) -> bool:
    """Whether the load is within tolerance of its target; False for NaN."""
    return abs(load_error_n(state)) <= state.plan.hold.load_tolerance(load_target_n(state) or 0.0)


def stage_within(state: EngineState) -> bool:
    """Whether the stage is within tolerance of its target; False for NaN."""
    return stage_error_um(state) <= state.plan.hold.stage_tolerance_um


def all_at_rest(state: EngineState) -> bool:
    """Whether every device reports that it does not move."""
    return all(sample is not None and sample.motion is MotionState.STOPPED for sample in map(state.devices.sample, state.devices.present))


def not_at_rest_reason(state: EngineState) -> str | None:
    """Return why the devices are not at rest in tolerance, as a clause that follows "because", or None."""
    for device in state.devices.present:
        sample = state.devices.sample(device)
        if sample is None or sample.motion is not MotionState.STOPPED:
            return f"the {device.words} moves"
    if not stage_within(state):
        return f"the stage is {stage_error_um(state):.1f} um from its target"
    if not load_within(state):
        return f"the load is {load_error_n(state):+.1f} N from its target"
    return None


def rest_fault(context: StepContext) -> bool:
    """Go to FAULT if a device moved while no motion was ordered; return True in that case.

    A load frame that a person moves is not checked: a load out of tolerance is requested again, but never downwards.
    """
    moved = _load_frame_moved(context.state) or _stage_moved(context.state)
    if moved is None:
        return False
    code, reason = moved
    guards = (("load_error_n", load_error_n(context.state)), ("stage_error_um", stage_error_um(context.state)))
    context.fault(Cause.DEVICE_FAULT, reason, *guards, code=code)
    return True


def _load_frame_moved(state: EngineState) -> tuple[FaultCode, str] | None:
    if state.devices.load is None or state.devices.load_frame is None or state.devices.load_frame.control is ControlMode.MANUAL:
        return None
    holding = state.state in (State.HOLDING, State.IMAGING)
    target_n = (
        load_target_n(state) if holding else state.hold.reached_load_n if state.state in (State.CALIBRATION_GATE, State.WARM_UP) else None
    )
    tolerance_n = state.plan.hold.load_tolerance(target_n or 0.0)
    return state.devices.standstill.problem(state.devices.load, target_n, tolerance_n, ramp_sign(state) if holding else 0.0)


def _stage_moved(state: EngineState) -> tuple[FaultCode, str] | None:
    if state.devices.stage is None or state.state not in (State.HOLDING, State.IMAGING) or stage_within(state):
        return None
    what = f"the stage is {stage_error_um(state):.1f} um from its target while nothing was ordered"
    return FaultCode.MOVED_AT_REST, f"{what}: check who moved it, or whether it slipped"
