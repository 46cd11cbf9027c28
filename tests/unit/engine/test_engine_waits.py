"""The warm-up gate before the first load, and holds that last until the drift rate is low."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semlive.data.experiment import AdaptiveHold, Phase, Plan, WarmUp
from semlive.engine import (
    Cause,
    DriftForecastUpdated,
    HoldDriftMeasured,
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
from semlive.engine.gates.adaptive_hold import drift_rate
from semlive.errors import BadInput

from .bench_in_memory import HOLD, IDENTITY, Run, S, plan_of

HERE = (0.0, 0.0)
LIMIT = 0.01


def gated(*stops: tuple[tuple[float, float], float | None], before: Phase = Phase.TENSION) -> Plan:
    return replace(plan_of(*stops), warm_up=WarmUp(LIMIT, 1800.0, before))


def pair(run: Run, rate_px_s: float, sigma_px_s: float = 0.0) -> None:
    """A pair, and its forecast some seconds later."""
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    run.wait(5.0)
    foresee(run, rate_px_s, sigma_px_s)


def foresee(run: Run, rate_px_s: float, sigma_px_s: float = 0.0) -> None:
    run.send(DriftForecastUpdated(run.now_ns, len(run.accepted) - 1, ((run.now_ns, rate_px_s, sigma_px_s),)))


def test_nothing_is_loaded_before_the_drift_is_expected_to_be_slow() -> None:
    run = Run(gated((HERE, None), ((6.0, 0.0), None), (HERE, 100.0), (HERE, 200.0)))
    run.begin()
    pair(run, 0.08)
    pair(run, 0.04)
    assert run.state.state is not State.WARM_UP
    for rate, sigma in ((0.02, 0.0), (0.009, 0.002)):
        assert run.of(RampTo) == []
        pair(run, rate, sigma)
    assert run.of(RampTo) == []
    pair(run, 0.006, 0.002)
    assert run.state.state in (State.RAMPING, State.SETTLING)
    assert [item.force_n for item in run.of(RampTo)] == [100.0]
    assert run.of(Transition)[-2].cause is Cause.WARMED_UP or run.of(Transition)[-1].cause is Cause.WARMED_UP
    pair(run, 1.0)
    pair(run, 1.0)
    assert run.state.state is State.COMPLETE
    steps = [item.decision.step for item in run.accepted]
    assert [item.step for item in steps] == list(range(7))
    assert [item.warm_up for item in steps] == [False, False, True, True, True, False, False]
    assert [item.load_n for item in steps] == [None, None, None, None, None, 100.0, 200.0]
    assert {item.shift_um for item in steps[2:]} == {HERE}


def test_a_plan_that_begins_with_a_load_is_measured_first() -> None:
    run = Run(gated((HERE, 100.0)))
    run.begin()
    assert run.of(RampTo) == []
    pair(run, 0.001)
    run.reach(State.IMAGING)
    assert run.force_n == 100.0
    assert [item.decision.step.warm_up for item in run.accepted] == [True]


def test_the_gate_may_be_before_the_calibration() -> None:
    run = Run(gated((HERE, None), ((6.0, 0.0), None), before=Phase.CALIBRATION))
    run.begin()
    pair(run, 0.08)
    pair(run, 0.001)
    pair(run, 0.08)
    assert [item.decision.step.warm_up for item in run.accepted] == [False, True, False]
    assert run.state.state is State.COMPLETE


def settling(*stops: tuple[tuple[float, float], float | None], max_wait_s: float = 1800.0) -> Run:
    """A run that waits after its first pair until the drift rate changes by less than 0.01 px/s from pair to pair."""
    rule = WarmUp(None, max_wait_s, Phase.CALIBRATION, LIMIT, continue_after_wait=True)
    run = Run(replace(plan_of(*stops), warm_up=rule))
    run.begin()
    return run


def test_the_gate_opens_when_the_drift_rate_has_settled_however_fast_it_is() -> None:
    run = settling((HERE, None), ((6.0, 0.0), None))
    for rate, sigma in ((0.50, 0.001), (0.40, 0.001), (0.395, 0.006), (0.394, 0.001)):
        pair(run, rate, sigma)
    assert [item.decision.step.warm_up for item in run.accepted] == [False, True, True, True]
    (opened,) = [item for item in run.of(Transition) if item.cause is Cause.WARMED_UP]
    assert dict(opened.details)["change_px_s"] == pytest.approx(0.001)
    pair(run, 0.39)
    assert run.state.state is State.COMPLETE


def test_without_a_decision_the_run_continues_after_the_longest_wait() -> None:
    run = settling((HERE, None), ((6.0, 0.0), None), max_wait_s=300.0)
    rate = 1.0
    while run.state.state is not State.COMPLETE and len(run.accepted) < 20:
        pair(run, rate)
        rate -= 0.02
    assert Cause.WARM_UP_ENDED in [item.cause for item in run.of(Transition)]
    assert 3 <= len(run.accepted) < 20
    assert not run.accepted[-1].decision.step.warm_up


def test_no_load_follows_without_a_decision() -> None:
    run = settling((HERE, None), (HERE, 100.0), max_wait_s=300.0)
    rate = 1.0
    while run.state.state is not State.PAUSED and len(run.accepted) < 20:
        pair(run, rate)
        rate -= 0.02
    assert run.state.state is State.PAUSED
    assert run.of(RampTo) == []


def test_without_a_forecast_the_run_continues_too() -> None:
    run = settling((HERE, None), ((6.0, 0.0), None), max_wait_s=300.0)
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    assert run.state.state is State.WARM_UP
    run.wait(400.0)
    pair(run, 0.1)
    assert [item.decision.step.warm_up for item in run.accepted] == [False, False]
    assert run.state.state is State.COMPLETE


def test_after_its_longest_wait_the_gate_prompts_and_the_operator_opens_it() -> None:
    run = Run(gated((HERE, None), (HERE, 100.0)))
    run.begin()
    while run.state.state is not State.PAUSED:
        pair(run, 0.02, 0.003)
    assert "after 30 min of warming up the drift is expected to be 1.2 +- 0.18 px/min; resume continues nevertheless" in run.state.message
    assert run.of(RampTo) == []
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    run.reach(State.IMAGING)
    assert run.force_n == 100.0


def test_a_missing_forecast_prompts_the_operator() -> None:
    run = Run(gated((HERE, None), (HERE, 100.0)))
    run.begin()
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    assert run.state.state is State.WARM_UP
    run.wait(2000.0, State.PAUSED)
    assert "the drift is not known" in run.state.message
    assert len(run.accepted) == 1


def test_a_fault_while_warming_up_does_not_open_the_gate() -> None:
    run = Run(gated((HERE, None), (HERE, 100.0)))
    run.begin()
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    run.fail_and_resume()
    assert run.state.state is State.WARM_UP
    foresee(run, 0.001)
    run.reach(State.IMAGING)
    assert run.force_n == 100.0


@pytest.mark.parametrize("forecast_given", [True, False])
def test_an_interrupted_warm_up_continues(forecast_given: bool) -> None:
    plan = gated((HERE, None), (HERE, 100.0))
    run = Run(plan)
    run.begin()
    pair(run, 0.08)
    pair(run, 0.04)
    before = InterruptedRun(
        tuple(item.decision for item in run.accepted),
        (7.0, -3.0),
        run.state.devices.load,
        run.state.devices.position,
        drift_forecast=run.state.analysis.drift_forecast if forecast_given else None,
    )
    run.state = start(plan, run.now_ns, interrupted_run=before)
    assert [(item.step, item.warm_up, item.load_n) for item in run.state.plan.steps] == [
        (0, False, None),
        (1, True, None),
        (2, False, 100.0),
    ]
    run.send(LinksOpening(run.now_ns))
    run.readings()
    run.send(LinksReady(run.now_ns, IDENTITY, IDENTITY))
    run.send(OperatorAction(run.now_ns, OperatorCommand.RESUME))
    if not forecast_given:
        assert run.state.state is State.WARM_UP
        foresee(run, 0.04)
    pair(run, 0.001)
    run.reach(State.IMAGING)
    run.scan()
    run.scan()
    assert [item.decision.step.warm_up for item in run.accepted] == [False, True, True, False]
    assert run.state.state is State.COMPLETE


def held_s(run: Run) -> float:
    """How long the last hold was."""
    (held,) = [
        value for item in run.of(Transition) if item.cause is Cause.HOLD_COMPLETE for name, value in item.details if name == "held_s"
    ][-1:]
    return float(held)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    longest=st.floats(30.0, 120.0),
    rates=st.lists(st.floats(0.0, 0.1), min_size=5, max_size=5),
    relaxes=st.floats(0.0, 0.5),
    settled_s=st.floats(1.0, 60.0),
    limits=st.sampled_from([(0.02, None), (None, 0.05), (0.02, 0.05)]),
)
def test_a_hold_is_never_shorter_than_it_must_be_nor_longer_than_it_may(
    longest: float, rates: list[float], relaxes: float, settled_s: float, limits: tuple[float | None, float | None]
) -> None:
    run = Run(replace(plan_of((HERE, 100.0)), adaptive_hold=AdaptiveHold(longest, *limits)))
    run.begin()
    run.reach(State.HOLDING)
    forecast = DriftForecastUpdated(run.now_ns, 0, tuple((run.now_ns + n * 20 * S, rate, 0.0) for n, rate in enumerate(rates)))
    run.send(forecast)
    began_ns = run.now_ns
    while run.state.state is State.HOLDING:
        # The load creeps more and more slowly, within its tolerance of 10 N.
        elapsed_s = (run.now_ns - began_ns) / S
        run.force_n = 100.0 - min(relaxes * settled_s, 8.0) * (1.0 - math.exp(-elapsed_s / settled_s))
        run.wait(0.5)
    assert HOLD.hold_s <= held_s(run) <= longest + run.poll_s
    assert run.state.state is State.IMAGING
    if held_s(run) < longest - run.poll_s and limits[0] is not None:
        assert drift_rate(forecast, run.now_ns)[0] <= limits[0]
    if limits[0] is None and relaxes == 0.0:
        assert held_s(run) == HOLD.hold_s


def test_frames_of_a_longer_hold_are_not_of_the_pair() -> None:
    run = Run(replace(plan_of((HERE, 100.0)), adaptive_hold=AdaptiveHold(300.0, max_rate_px_s=0.02)))
    run.begin()
    run.reach(State.HOLDING)
    foresee(run, 0.1)
    run.wait(40.0)
    assert run.state.state is State.HOLDING
    assert "made longer, because a drift rate of 6 px/min is expected" in run.state.message
    run.scan()
    foresee(run, 0.001)
    run.reach(State.IMAGING)
    run.scan(run.now_ns - 20 * S)
    assert len(run.refusals) == 2
    run.scan()
    run.scan()
    assert run.state.state is State.COMPLETE
    assert held_s(run) > 120.0


def test_frames_of_the_hold_determine_its_drift_better_than_a_forecast() -> None:
    run = Run(replace(plan_of((HERE, 100.0)), adaptive_hold=AdaptiveHold(300.0, max_rate_px_s=0.02)))
    run.begin()
    run.reach(State.HOLDING)
    foresee(run, 0.001)
    begin_ns = run.now_ns
    run.send(HoldDriftMeasured(run.now_ns, begin_ns - S, 0.05))  # between frames of an earlier hold
    run.wait(10.0)
    run.send(HoldDriftMeasured(run.now_ns, begin_ns, 0.05))
    run.wait(60.0)
    assert run.state.state is State.HOLDING
    assert "made longer, because the drift rate between frames of this hold was 3 px/min" in run.state.message
    foresee(run, 0.001)
    run.wait(10.0)
    assert run.state.state is State.HOLDING
    run.send(HoldDriftMeasured(run.now_ns, begin_ns + 40 * S, 0.015))
    run.wait(2.0)
    assert run.state.state is State.IMAGING


def test_drift_measured_in_an_earlier_hold_does_not_count() -> None:
    run = Run(replace(plan_of((HERE, 100.0)), adaptive_hold=AdaptiveHold(300.0, max_rate_px_s=0.02)))
    run.begin()
    run.reach(State.HOLDING)
    foresee(run, 0.001)
    run.send(HoldDriftMeasured(run.now_ns, run.now_ns - 60 * S, 0.05))
    run.reach(State.IMAGING)
    assert held_s(run) == HOLD.hold_s


def test_a_forecast_is_read_between_its_scans() -> None:
    observed = DriftForecastUpdated(0, 0, ((0, 0.1, 0.0), (10 * S, 0.2, 0.02), (20 * S, 0.4, 0.04)))
    assert drift_rate(observed, -S) == (0.1, 0.0)
    assert drift_rate(observed, 5 * S) == pytest.approx((0.15, 0.01))
    assert drift_rate(observed, 20 * S) == (0.4, 0.04)
    assert drift_rate(observed, 99 * S) == (0.4, 0.04)
    assert drift_rate(None, 0) == (math.inf, math.inf)


def test_pairs_of_a_warm_up_do_not_count_as_steps_of_the_plan() -> None:
    run = Run(gated((HERE, None), (HERE, 100.0)))
    run.begin()
    pair(run, 0.08)
    pair(run, 0.04)
    done = tuple(item.decision for item in run.accepted)
    with pytest.raises(BadInput, match="of a plan of 0 steps"):
        InterruptedRun(done).steps_of(replace(run.plan, steps=()))
