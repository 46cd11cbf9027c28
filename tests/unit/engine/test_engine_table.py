"""The table of transitions, and the load history."""

from __future__ import annotations

import pytest

from semlive.engine import FINAL_STATES, Cause, InvalidTransition, State
from semlive.engine.context import StepContext
from semlive.engine.load_history import LoadHistory, frame_load
from semlive.engine.states import TRANSITIONS, next_state

from .bench_in_memory import Run, S, plan_of


def test_a_pair_that_is_not_listed_raises() -> None:
    for state in State:
        for cause in Cause:
            if (state, cause) not in TRANSITIONS:
                with pytest.raises(InvalidTransition):
                    next_state(state, cause)


def test_every_state_but_the_first_is_reached_and_every_one_but_the_last_is_left() -> None:
    reached = set(TRANSITIONS.values())
    left = {state for state, _ in TRANSITIONS}
    assert set(State) - reached == {State.IDLE}
    assert set(State) - left == FINAL_STATES
    assert {cause for _, cause in TRANSITIONS} == set(Cause)


def test_only_ramping_continues_on_a_command_of_operator_or_protocol() -> None:
    into = {(state, cause) for (state, cause), after in TRANSITIONS.items() if after is State.RAMPING}
    assert into == {
        (State.READY, Cause.START),
        (State.RAMPING, Cause.STAGE_ARRIVED),
        (State.RAMPING, Cause.APPROACH_AGAIN),
        (State.SETTLING, Cause.APPROACH_AGAIN),
        (State.STEP_DONE, Cause.NEXT_STEP),
        (State.CALIBRATION_GATE, Cause.CALIBRATION_ACCEPTED),
        (State.WARM_UP, Cause.MEASURE_AGAIN),
        (State.WARM_UP, Cause.WARMED_UP),
        (State.WARM_UP, Cause.WARM_UP_ENDED),
        (State.PAUSED, Cause.RESUME),
        (State.RESUMING, Cause.RESUME),
    }


def test_stop_and_abort_work_everywhere_before_the_end() -> None:
    for state in set(State) - FINAL_STATES:
        assert next_state(state, Cause.ABORT) is State.ABORTED
        if state is not State.STOPPING:
            assert next_state(state, Cause.STOP) is State.STOPPING


def test_a_state_cannot_be_set_next_to_the_table() -> None:
    turn = StepContext(Run(plan_of(((0.0, 0.0), None))).state)
    with pytest.raises(TypeError, match="changes by transition"):
        turn.update(state=State.IMAGING)  # pyright: ignore[reportCallIssue]


def test_the_history_gives_the_samples_around_a_scan() -> None:
    history = LoadHistory(keep_ns=10_000 * S)
    for i in range(2000):
        history = history.with_sample(i * S, float(i))
    load = frame_load(history, round(255.5 * S), 260 * S)
    assert load is not None
    assert (load.before_n, load.after_n, load.mean_n) == (255.0, 260.0, 257.5)
    assert frame_load(LoadHistory(keep_ns=S), 0, S) is None
    assert frame_load(history, -S, S) is None


def test_a_scan_has_the_mean_of_the_strain_gage_over_the_readings_that_it_gave() -> None:
    history = LoadHistory(keep_ns=100 * S)
    for i, strain in enumerate((None, 1e-4, None, 3e-4, 5e-4)):
        history = history.with_sample(i * S, 100.0, strain)
    load = frame_load(history, 0, 3 * S)
    assert load is not None
    assert load.gage_strain == pytest.approx(2e-4)
    assert load.gage_strain_sigma == pytest.approx(1e-4 / 2**0.5)
    early = LoadHistory(keep_ns=100 * S).with_sample(0, 100.0).with_sample(S, 100.0)
    silent = frame_load(early, 0, S)
    assert silent is not None
    assert (silent.gage_strain, silent.gage_strain_sigma) == (None, None)


def test_the_history_is_bounded_and_in_order() -> None:
    history = LoadHistory(keep_ns=100 * S)
    for i in range(5000):
        history = history.with_sample(i * S, 0.0)
    stored = history.between(0, 10_000 * S)
    assert 100 <= len(stored) <= 100 + 3 * 256
    assert stored[-1][0] == 4999 * S
    assert history.with_sample(10 * S, 1.0) is history
