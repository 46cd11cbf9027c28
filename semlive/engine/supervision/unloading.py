"""Rules of unloading: semlive reduces a load only where the plan does, and images unloaded pairs only without load.

Loading is path dependent: unloading and loading again changes the specimen. So semlive does not reduce a load that is higher than its
target, whatever the cause; a person decides.
"""

from __future__ import annotations

from semlive.data.experiment import Limits, Phase
from semlive.engine.state import EngineState

_UNLOADED_FRACTION = 0.05
"""Largest preload and zero offset of unloaded pairs, as a fraction of the force limit."""


def planned_load_before_n(state: EngineState) -> float:
    """Return the planned load before the present step, N; 0 before the first load."""
    loads = [step.load_n for step in state.plan.steps[: state.step_index] if step.load_n is not None]
    return loads[-1] if loads else 0.0


def ramp_sign(state: EngineState) -> float:
    """Return +1 if the present step raises the load, -1 if it lowers it, 0 without a change or without a commanded load."""
    if state.step.load_n is None:
        return 0.0
    change_n = state.step.load_n - planned_load_before_n(state)
    return (change_n > 0) - (change_n < 0)


def unloading_problem(state: EngineState) -> str | None:
    """Return why the order of the present step would unload the specimen although the plan does not, or None."""
    target_n = state.step.load_n
    if target_n is None or state.devices.load is None:
        return None
    now_n, before_n = state.devices.load.force_n, planned_load_before_n(state)
    tolerance_n = state.plan.hold.load_tolerance(target_n)
    reduces = abs(now_n) > abs(target_n) + tolerance_n or (now_n * target_n < 0 and abs(now_n) > tolerance_n)
    plan_reduces = abs(before_n) > abs(target_n) or before_n * target_n < 0
    if not reduces or plan_reduces:
        return None
    return (
        f"the load is {now_n:.1f} N, more than the {target_n:g} N of step {state.step.number}, and the plan does not unload here; "
        "unload by hand at the machine if the specimen may be unloaded, then resume, or stop"
    )


def unloaded_max_n(limits: Limits) -> float:
    """Return the largest load of an unloaded pair, N: `limits.unloaded_max_n`, by default 5 % of the force limit."""
    if limits.unloaded_max_n is not None:
        return limits.unloaded_max_n
    return _UNLOADED_FRACTION * max(abs(limits.force_max_n), abs(limits.force_min_n))


def loaded_problem(state: EngineState) -> str | None:
    """Return why a step before the first load must not begin, because the load frame carries load, or None."""
    if state.devices.load is None or state.devices.load_frame is None or state.step.load_n is not None or state.step.phase is Phase.TENSION:
        return None
    if any(step.load_n is not None for step in state.plan.steps[: state.step_index]):
        return None
    now_n, max_n = state.devices.load.force_n, max(unloaded_max_n(state.limits), state.plan.hold.load_tolerance_n)
    if abs(now_n) <= max_n:
        return None
    return (
        f"the load is {now_n:.1f} N, but step {state.step.number} is to be imaged without load (at most {max_n:g} N): "
        "unload the specimen or zero the load cell, or raise limits.unloaded_max_n for an intended preload"
    )
