"""The calibration's gate: nothing is loaded before the translations are known to determine the distortion.

What is imaged under load cannot be imaged unloaded again, so the newest pair's judgement is waited for: some seconds, once in a run.
"""

from __future__ import annotations

from collections.abc import Sequence

from semlive.data.experiment import Step
from semlive.engine import warm_up_gate
from semlive.engine.motion import start_step
from semlive.engine.state import EngineState, StepContext
from semlive.engine.states import Cause


def is_closed(state: EngineState) -> bool:
    """Whether the gate is before the step that comes now, and has not been passed."""
    if not state.plan.calibration_gate or state.calibration_gate_passed or state.step_index == 0:
        return False
    return state.step.load_n is not None


def passed(done: Sequence[Step]) -> bool:
    """Whether an interrupted run with these steps done had passed the gate."""
    return any(one.load_n is not None for one in done)


def evaluate(turn: StepContext) -> None:
    """In JUDGING: go on when the newest pair says that the calibration is good enough; ask when it is not, or nothing is said."""
    state = turn.state
    seen = state.calibration_assessment
    if (seen is None or seen.pair < state.step_index - 1) and state.seconds_since(state.since_ns) < _JUDGED_S:
        return
    if seen is None or seen.rejection_reason:
        told = (
            f"nothing was said of the calibration for {_JUDGED_S:g} s"
            if seen is None
            else f"the calibration is refused: {seen.rejection_reason}"
        )
        turn.stop_and_go(Cause.POOR_CALIBRATION, f"{told}; resume loads the specimen all the same, or stop")
        turn.update(calibration_asked=True)
        return
    turn.update(calibration_gate_passed=True)
    proceed(turn)


def proceed(turn: StepContext) -> None:
    """To the load, by way of the warm-up gate where there is one."""
    if warm_up_gate.is_closed(turn.state):
        warm_up_gate.enter(turn, Cause.WARM_UP)
    else:
        turn.transition(Cause.CALIBRATION_ACCEPTED)
        start_step(turn)


_JUDGED_S = 300.0
"""The newest pair's judgement takes a second or two; where that pair could not be analysed, the one before it holds after this."""
