"""The warm-up gate: nothing is loaded before the drift is expected to be slow enough.

While it waits the run takes further pairs at the place of the step to come: each tells the drift anew, so that the forecast that opens
the gate is never an old one. They are pairs like others, in the log and in the estimate, which they only make better.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from semlive.data.experiment import Phase, Plan, Step
from semlive.engine.adaptive_hold import drift_rate
from semlive.engine.motion import start_step
from semlive.engine.state import EngineState, StepContext
from semlive.engine.states import Cause


def is_closed(state: EngineState) -> bool:
    """Whether the gate is before the step that comes now, and has not been passed."""
    rule, step = state.plan.warm_up, state.step
    if rule is None or state.warm_up_gate_passed or step.warm_up:
        return False
    return step.load_n is not None or (rule.gate_phases is not Phase.TENSION and state.step_index > 0)


def passed(plan: Plan, done: Sequence[Step]) -> bool:
    """Whether an interrupted run with these steps done had passed the gate."""
    rule = plan.warm_up
    beyond = [one for one in done if not one.warm_up]
    return any(one.load_n is not None for one in beyond) or (rule is not None and rule.gate_phases is not Phase.TENSION and len(beyond) > 1)


def with_measurement(plan: Plan, index: int) -> Plan:
    """The plan with one pair more before a step, at that step's place and with the load left alone."""
    later = plan.steps[index]
    more = Step(index, Phase.CALIBRATION, later.shift_um, later.shift_px, None, warm_up=True)
    rest = (replace(step, step=step.step + 1) for step in plan.steps[index:])
    return replace(plan, steps=(*plan.steps[:index], more, *rest))


def enter(turn: StepContext, cause: Cause) -> None:
    """Come to the gate."""
    turn.transition(cause)
    if turn.state.warming_since_ns is None:
        turn.update(warming_since_ns=turn.state.time_ns)


def start_extra_pair(turn: StepContext) -> None:
    """Begin one pair more before the step that comes now."""
    turn.update(plan=with_measurement(turn.state.plan, turn.state.step_index))
    start_step(turn)


def evaluate(turn: StepContext) -> None:
    """In WARMING: go on when the newest pair's forecast says so; ask when that takes too long; else measure again."""
    state = turn.state
    rule, since_ns = state.plan.warm_up, state.warming_since_ns
    assert rule is not None
    assert since_ns is not None
    known = state.drift_forecast is not None and state.drift_forecast.pair >= state.step_index - 1
    waited_s = state.seconds_since(since_ns)
    rate, sigma = drift_rate(state.drift_forecast, state.time_ns + round(state.plan.hold.hold_s * 1e9))
    guards = (("rate_px_s", rate), ("sigma_px_s", sigma), ("waited_s", waited_s)) if math.isfinite(rate) else ()
    if known and rate + sigma <= rule.max_rate_px_s:
        turn.transition(Cause.WARMED_UP, *guards)
        turn.update(warm_up_gate_passed=True)
        turn.announce(f"warm: the drift is expected to be {_per_min(rate, sigma)}")
        start_step(turn)
    elif waited_s >= rule.max_wait_s and (known or state.seconds_since(state.since_ns) >= _FORECAST_S):
        told = f"is expected to be {_per_min(rate, sigma)}" if guards else "is not known"
        reason = f"after {rule.max_wait_s / 60:.0f} min of warming up the drift {told}; resume goes on all the same, or stop"
        turn.stop_and_go(Cause.WARM_UP_TIMEOUT, reason, *guards)
    elif known or state.step_index == 0:
        turn.transition(Cause.MEASURE_AGAIN, *guards)
        turn.announce(f"warming up: the drift is expected to be {_per_min(rate, sigma)}, and {60 * rule.max_rate_px_s:.2g} is wanted")
        start_extra_pair(turn)


_FORECAST_S = 60.0
"""The newest pair's forecast takes a second or two; one that is not there after this will not come."""


def _per_min(rate_px_s: float, sigma_px_s: float) -> str:
    return f"{60 * rate_px_s:.2g} +- {60 * sigma_px_s:.2g} px/min"
