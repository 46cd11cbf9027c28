"""A snapshot of a run for those who only look."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.experiment import Phase
from semlive.engine.states import State
from semlive.engine.turn import EngineState


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a run is.

    Attributes:
        state: of the protocol.
        step: index of the step.
        steps: number of steps.
        phase: what the step's pair is for.
        hold_left_s: experiment seconds until the hold is over; None unless holding.
        load_n: last reading, None before the first.
        target_n: the step's load, or None.
        shift_um: the step's shift.
        frames_of_pair: frames of the step's pair that are there, 0 or 1.
        message: the last sentence for the operator.
    """

    state: State
    step: int
    steps: int
    phase: Phase
    hold_left_s: float | None
    load_n: float | None
    target_n: float | None
    shift_um: tuple[float, float]
    frames_of_pair: int
    message: str


def progress(state: EngineState) -> Progress:
    """What to show of a state."""
    holding = state.at is State.HOLDING
    return Progress(
        state=state.at,
        step=state.step_index,
        steps=len(state.plan.steps),
        phase=state.step.phase,
        hold_left_s=max(0.0, -state.seconds_since(state.hold_end_ns)) if holding else None,
        load_n=None if state.load is None else state.load.force_n,
        target_n=state.step.load_n,
        shift_um=state.step.shift_um,
        frames_of_pair=0 if state.first is None else 1,
        message=state.message,
    )
