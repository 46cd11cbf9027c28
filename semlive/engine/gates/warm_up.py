"""Warm-up gate: the load is applied only after the forecast drift rate, or its change from pair to pair, is below its maximum.

While the gate is closed, the run images further pairs at the stage position of the next step. Each pair updates the forecast, so the gate
opens on a recent forecast. These pairs are logged and used in the estimate like all others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from semlive.data.experiment import Phase, Plan, Step, WarmUp
from semlive.engine.context import StepContext
from semlive.engine.gates.adaptive_hold import drift_rate
from semlive.engine.motion import start_step
from semlive.engine.state import EngineState
from semlive.engine.states import Cause


def is_closed(state: EngineState) -> bool:
    """Whether the gate is before the present step and has not been passed."""
    rule, step = state.plan.warm_up, state.step
    if rule is None or state.gates.warm_up_passed or step.warm_up:
        return False
    return step.load_n is not None or (rule.gate_phases is not Phase.TENSION and state.step_index > 0)


def passed(plan: Plan, completed_steps: Sequence[Step]) -> bool:
    """Whether an interrupted run with these completed steps had passed the gate."""
    rule = plan.warm_up
    planned = [step for step in completed_steps if not step.warm_up]
    return any(step.load_n is not None for step in planned) or (
        rule is not None and rule.gate_phases is not Phase.TENSION and len(planned) > 1
    )


def with_measurement(plan: Plan, index: int) -> Plan:
    """Return the plan with one additional pair before the step of an index, at its stage position and without a load command."""
    next_step = plan.steps[index]
    extra_step = Step(index, Phase.CALIBRATION, next_step.shift_um, next_step.shift_px, None, warm_up=True)
    remaining = (replace(step, step=step.step + 1) for step in plan.steps[index:])
    return replace(plan, steps=(*plan.steps[:index], extra_step, *remaining))


def enter(context: StepContext, cause: Cause) -> None:
    """Enter WARM_UP and store the time of the first entry."""
    context.transition(cause)
    if context.state.gates.warming_since_ns is None:
        store_begin(context)


def store_begin(context: StepContext) -> None:
    """Store the present time as the time of the first entry."""
    context.update(gates=replace(context.state.gates, warming_since_ns=context.state.time_ns))


def start_extra_pair(context: StepContext) -> None:
    """Begin an additional pair before the present step."""
    context.update(plan=with_measurement(context.state.plan, context.state.step_index))
    start_step(context)


def evaluate(context: StepContext) -> None:
    """In WARM_UP: continue if the forecast of the newest pair allows it; pause or continue after the maximum time; else measure again."""
    state = context.state
    rule, since_ns = state.plan.warm_up, state.gates.warming_since_ns
    assert rule is not None
    assert since_ns is not None
    forecast_available = state.analysis.drift_forecast is not None and state.analysis.drift_forecast.pair >= state.step_index - 1
    waited_s = state.seconds_since(since_ns)
    drift = _forecast_drift(state, rule)
    guards = drift.guards(waited_s)
    if forecast_available and drift.is_allowed(rule):
        _open(context, Cause.WARMED_UP, f"warm: the drift is expected to be {drift.text}", *guards)
    elif waited_s >= rule.max_wait_s and (forecast_available or state.seconds_since(state.since_ns) >= _FORECAST_TIMEOUT_S):
        drift_text = f"is expected to be {drift.text}" if guards else "is not known"
        reason = f"after {rule.max_wait_s / 60:.0f} min of warming up the drift {drift_text}"
        if rule.continue_after_wait and state.step.load_n is None:  # only the operator decides to load a specimen that drifts
            _open(context, Cause.WARM_UP_ENDED, f"{reason}; the run continues", *guards)
        else:
            context.stop_and_transition(Cause.WARM_UP_TIMEOUT, f"{reason}; resume continues nevertheless, or stop", *guards)
    elif forecast_available or state.step_index == 0:
        context.transition(Cause.MEASURE_AGAIN, *guards)
        context.announce(f"warming up: the drift is expected to be {drift.text}, and {_required(rule)} is wanted")
        context.update(gates=replace(state.gates, previous_rate_px_s=(drift.rate_px_s, drift.sigma_px_s) if guards else None))
        start_extra_pair(context)


def _open(context: StepContext, cause: Cause, message: str, *guards: tuple[str, float]) -> None:
    """Pass the gate and begin the present step."""
    context.transition(cause, *guards)
    context.update(gates=replace(context.state.gates, warm_up_passed=True))
    context.announce(message)
    start_step(context)


@dataclass(frozen=True, slots=True)
class _Drift:
    """Forecast drift rate of the next scan and its change since the last pair, each with its standard uncertainty; infinite if unknown."""

    rate_px_s: float
    sigma_px_s: float
    change_px_s: float = math.inf
    change_sigma_px_s: float = math.inf

    @property
    def text(self) -> str:
        """Rate for messages."""
        change = f", changed by {60 * self.change_px_s:.2g}" if math.isfinite(self.change_px_s) else ""
        return f"{60 * self.rate_px_s:.2g} +- {60 * self.sigma_px_s:.2g} px/min{change}"

    def is_allowed(self, rule: WarmUp) -> bool:
        """Whether the drift is as slow, and as constant, as the rule requires."""
        slow = rule.max_rate_px_s is None or self.rate_px_s + self.sigma_px_s <= rule.max_rate_px_s
        return slow and (rule.max_change_px_s is None or self.change_px_s + self.change_sigma_px_s <= rule.max_change_px_s)

    def guards(self, waited_s: float) -> tuple[tuple[str, float], ...]:
        """Values for the log; none without a forecast."""
        if not math.isfinite(self.rate_px_s):
            return ()
        change = (("change_px_s", self.change_px_s),) if math.isfinite(self.change_px_s) else ()
        return (("rate_px_s", self.rate_px_s), ("sigma_px_s", self.sigma_px_s), *change, ("waited_s", waited_s))


def _forecast_drift(state: EngineState, rule: WarmUp) -> _Drift:
    rate, sigma = drift_rate(state.analysis.drift_forecast, state.time_ns + round(state.plan.hold.hold_s * 1e9))
    if rule.max_change_px_s is None or state.gates.previous_rate_px_s is None or not math.isfinite(rate):
        return _Drift(rate, sigma)
    before, sigma_before = state.gates.previous_rate_px_s
    return _Drift(rate, sigma, abs(rate - before), math.hypot(sigma, sigma_before))


def _required(rule: WarmUp) -> str:
    """Maxima of a rule, for messages."""
    rate = [] if rule.max_rate_px_s is None else [f"{60 * rule.max_rate_px_s:.2g}"]
    change = [] if rule.max_change_px_s is None else [f"a change from pair to pair of {60 * rule.max_change_px_s:.2g} px/min"]
    return " and ".join((*rate, *change))


_FORECAST_TIMEOUT_S = 60.0
"""Longest wait for the forecast of the newest pair, which takes 1-2 s."""
