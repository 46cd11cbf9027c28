"""Calibration gate: the load is applied only after the translations have been shown to determine the distortion.

Unloaded images cannot be repeated after loading. The engine therefore waits for the assessment of the newest pair: some seconds, once per
run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from semlive.data.experiment import Step
from semlive.engine.context import StepContext
from semlive.engine.gates import warm_up
from semlive.engine.motion import start_step
from semlive.engine.state import EngineState
from semlive.engine.states import Cause


def is_closed(state: EngineState) -> bool:
    """Whether the gate is before the present step and has not been passed."""
    if not state.plan.calibration_gate or state.gates.calibration_passed or state.step_index == 0:
        return False
    return state.step.load_n is not None


def passed(completed_steps: Sequence[Step]) -> bool:
    """Whether an interrupted run with these completed steps had passed the gate."""
    return any(step.load_n is not None for step in completed_steps)


def evaluate(context: StepContext) -> None:
    """In CALIBRATION_GATE: continue when the calibration is accepted; pause for the operator if it is rejected or not assessed in time."""
    state = context.state
    assessment = state.analysis.calibration
    if (assessment is None or assessment.pair < state.step_index - 1) and state.seconds_since(state.since_ns) < _ASSESSMENT_TIMEOUT_S:
        return
    if assessment is None or assessment.rejection_reason:
        problem = (
            f"the analysis did not assess the calibration within {_ASSESSMENT_TIMEOUT_S:g} s"
            if assessment is None
            else f"the calibration is refused: {assessment.rejection_reason}"
        )
        context.stop_and_transition(Cause.POOR_CALIBRATION, f"{problem}; resume loads the specimen nevertheless, or stop")
        context.update(gates=replace(context.state.gates, calibration_rejected=True))
        return
    context.update(gates=replace(context.state.gates, calibration_passed=True))
    proceed(context)


def proceed(context: StepContext) -> None:
    """Begin the first load step, or enter the warm-up gate if it is closed."""
    if warm_up.is_closed(context.state):
        warm_up.enter(context, Cause.WARM_UP)
    else:
        context.transition(Cause.CALIBRATION_ACCEPTED)
        start_step(context)


_ASSESSMENT_TIMEOUT_S = 300.0
"""Longest wait for the assessment of the newest pair, which takes 1-2 s; after this time the assessment of the previous pair is used."""
