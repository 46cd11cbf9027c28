"""Snapshot of a run for display."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.experiment import Phase
from semlive.engine.state import EngineState
from semlive.engine.states import State


@dataclass(frozen=True, slots=True)
class RunStatus:
    """Status of a run.

    Attributes:
        state: state of the protocol.
        step: index of the step.
        steps: number of steps.
        phase: purpose of the pair of the step.
        hold_left_s: experiment seconds until the hold is over; None unless holding.
        load_n: last reading, None before the first.
        target_n: the step's load, or None.
        shift_um: the step's shift.
        pair_frames_accepted: number of accepted frames of the pair of the step, 0 or 1.
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
    pair_frames_accepted: int
    message: str


def progress(state: EngineState) -> RunStatus:
    """Return the status that is displayed for a state."""
    holding = state.state is State.HOLDING
    return RunStatus(
        state=state.state,
        step=state.step_index,
        steps=len(state.plan.steps),
        phase=state.step.phase,
        hold_left_s=max(0.0, -state.seconds_since(state.hold_end_ns)) if holding else None,
        load_n=None if state.load is None else state.load.force_n,
        target_n=state.step.load_n,
        shift_um=state.step.shift_um,
        pair_frames_accepted=0 if state.first is None else 1,
        message=state.message,
    )
