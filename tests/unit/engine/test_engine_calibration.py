"""The calibration's gate: nothing is loaded before the translations are known to determine the distortion."""

from __future__ import annotations

from dataclasses import replace

from semlive.data.experiment import Plan, WarmUp
from semlive.engine import (
    CalibrationAssessed,
    Cause,
    InterruptedRun,
    LinksOpening,
    LinksReady,
    OperatorAction,
    OperatorCommand,
    RampTo,
    State,
    Transition,
    start,
)

from .bench_in_memory import IDENTITY, Run, S, plan_of

HERE, THERE = (0.0, 0.0), (6.0, 0.0)
WHY = "distortion not determined yet: the pairs so far moved 6 px along x and 0.3 px along y"


def gated(*stops: tuple[tuple[float, float], float | None]) -> Plan:
    return replace(plan_of(*stops), calibration_gate=True)


def pair(run: Run, refused: str | None = None) -> None:
    """A pair, and its estimate some seconds later."""
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    if refused is not None:
        run.wait(5.0)
        judge(run, refused)


def judge(run: Run, refused: str) -> None:
    run.send(CalibrationAssessed(run.now_ns, len(run.accepted) - 1, refused))


def calibrated(refused: str | None, *, warm_up: WarmUp | None = None) -> Run:
    run = Run(replace(gated((HERE, None), (THERE, None), (HERE, 100.0), (HERE, 200.0)), warm_up=warm_up))
    run.begin()
    pair(run, WHY)
    pair(run, refused)
    return run


def test_the_load_waits_for_the_newest_pairs_judgement() -> None:
    run = calibrated(None)
    assert run.state.state is State.CALIBRATION_GATE
    assert run.of(RampTo) == []
    run.wait(200.0)
    assert run.state.state is State.CALIBRATION_GATE
    judge(run, "")
    run.reach(State.IMAGING)
    assert run.force_n == 100.0
    pair(run)
    run.reach(State.IMAGING)
    pair(run)
    assert run.state.state is State.COMPLETE
    assert [item.cause for item in run.of(Transition)].count(Cause.CALIBRATION_CHECK) == 1


def test_a_refused_calibration_pauses_with_its_figures_and_the_operator_can_load_anyway() -> None:
    run = calibrated(WHY)
    assert run.state.state is State.PAUSED
    assert run.state.calibration_question_open
    assert run.state.message == f"the calibration is refused: {WHY}; resume loads the specimen nevertheless, or stop"
    assert run.of(RampTo) == []
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.reach(State.IMAGING)
    assert run.force_n == 100.0
    assert not run.state.calibration_question_open


def test_a_pause_while_it_waits_does_not_open_the_gate() -> None:
    run = calibrated(None)
    run.send(OperatorAction(run.now_ns, OperatorCommand.PAUSE))
    assert not run.state.calibration_question_open
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    assert run.state.state is State.CALIBRATION_GATE
    judge(run, WHY)
    assert run.state.state is State.PAUSED
    assert run.of(RampTo) == []


def test_a_pair_that_could_not_be_analysed_is_not_waited_for_for_ever() -> None:
    run = calibrated(None)
    run.wait(310.0, State.PAUSED)
    assert WHY in run.state.message


def test_a_fault_while_it_waits_does_not_open_the_gate() -> None:
    run = calibrated(None)
    run.fail_and_resume()
    assert run.state.state is State.CALIBRATION_GATE


def test_the_warm_up_gate_comes_after_it() -> None:
    for refused in ("", WHY):
        run = calibrated(refused, warm_up=WarmUp(0.01, 1800.0))
        if refused:
            run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
        assert [item.after for item in run.of(Transition)].count(State.WARM_UP) == 1
        assert run.of(RampTo) == []


def test_an_interrupted_run_asks_again_unless_it_was_loaded() -> None:
    for pairs in (2, 3):
        run = calibrated("")
        if pairs == 3:
            pair(run)
        done = tuple(item.decision for item in run.accepted)
        plan = gated((HERE, None), (THERE, None), (HERE, 100.0), (HERE, 200.0))
        before = InterruptedRun(
            done, (7.0, -3.0), run.state.devices.load, run.state.devices.position, calibration_assessment=CalibrationAssessed(9 * S, 1, WHY)
        )
        run.load_goal_n = run.stage_goal_um = None
        run.state = start(plan, run.now_ns, interrupted_run=before)
        run.send(LinksOpening(run.now_ns))
        run.readings()
        run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
        run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
        assert (run.state.state is State.PAUSED) == (pairs == 2), run.state.state
        assert run.state.gates.calibration_passed == (pairs == 3)
