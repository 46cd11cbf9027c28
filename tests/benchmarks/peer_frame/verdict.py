"""Held against what must happen: the failings of a scenario, and the figures of a campaign."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from .scenario import STOP_BAR_S, TOLERANCE_N, Ending, Observed, Scenario

REPEAT_S = 1.5
"""Stop orders to a device that moves on follow one another at least this fast."""
_STOPS = (Ending.FAULT, Ending.STOPPED, Ending.RECOVERED)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was found of a scenario.

    Attributes:
        scenario: the scenario.
        observed: what was seen; None if the trial itself failed.
        failings: one phrase for each thing that is not as it must be; empty: passed.
        notes: what is worth knowing and fails nothing.
    """

    scenario: Scenario
    observed: Observed | None
    failings: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Everything was as it must be."""
        return not self.failings


def judge(scenario: Scenario, observed: Observed) -> Verdict:
    """Compare what was seen with what must happen."""
    failings = (*_ending(scenario, observed), *_stop(scenario, observed), *_load(scenario, observed), *_message(scenario, observed))
    return Verdict(scenario, observed, tuple(failings), tuple(_notes(scenario, observed)))


def _ending(scenario: Scenario, observed: Observed) -> Iterator[str]:
    must = scenario.expected
    match must.ending:
        case Ending.COMPLETE:
            if observed.exit_code != 0:
                yield f"did not complete (exit status {observed.exit_code})"
            if observed.faults:
                yield f"{len(observed.faults)} faults"
        case Ending.FAULT:
            if not observed.faults:
                yield "no /fault"
            elif not observed.faults[0].code:
                yield "/fault without a code"
            if observed.exit_code == 0:
                yield "run complete, exit status 0"
        case Ending.REFUSED:
            if observed.moved:
                yield "motion was ordered"
            if observed.exit_code not in (1, 2):
                yield f"not refused (exit status {observed.exit_code})"
            elif observed.exit_code == 1 and not observed.faults:
                yield "ended without a /fault"
            elif observed.exit_code == 1 and not observed.faults[0].code:
                yield "/fault without a code"
        case Ending.PROMPTED:
            if not (observed.asked or observed.faults or observed.exit_code == 2):
                yield "the operator was not asked"
        case Ending.RECOVERED:
            if not observed.faults:
                yield "no /fault"
            if observed.exit_code != 0:
                yield f"did not complete after the operator resumed (exit status {observed.exit_code})"
        case Ending.STOPPED:
            if observed.exit_code == 0:
                yield "run complete, exit status 0"
        case Ending.SAFE:
            pass
    if observed.exit_code is None:
        yield "had to be killed"
    if "Traceback" in observed.said:
        yield "a traceback reached the terminal"
    if "semlive itself failed" in observed.said:
        yield "ended with an internal error"


def _stop(scenario: Scenario, observed: Observed) -> Iterator[str]:
    must = scenario.expected
    if must.stop_within_s is not None and must.ending in _STOPS and observed.instant_s is not None:
        if observed.stop_after_s is None:
            yield "no stop order"
        elif observed.stop_after_s > must.stop_within_s:
            yield f"stop order after {observed.stop_after_s:.2f} s, {must.stop_within_s:g} s are allowed"
        if observed.silence_s > REPEAT_S:
            yield f"moved for {observed.silence_s:.1f} s without a further stop order"
    if must.no_orders and must.ending in (Ending.FAULT, Ending.PROMPTED, Ending.STOPPED) and _orders_after(scenario, observed):
        yield f"{observed.orders} motions ordered after the fault"


def _orders_after(scenario: Scenario, observed: Observed) -> bool:
    # A displacement drive is moved by short jogs, which continue until the fault is detected.
    return observed.orders > 0 and not scenario.is_displacement


def _load(scenario: Scenario, observed: Observed) -> Iterator[str]:
    must = scenario.expected
    if must.peak_n is not None and observed.peak_n > must.peak_n:
        yield f"peak {observed.peak_n:.0f} N, {must.peak_n:.0f} N are allowed"
    if observed.unloadings and not must.unloads:
        yield f"ordered to unload: {observed.unloadings[0]}"
    if must.loaded_pairs is not None and observed.loaded_pairs != must.loaded_pairs:
        yield f"{observed.loaded_pairs} pairs under load accepted, {must.loaded_pairs} expected"
    if must.final_n and not any(abs(observed.final_n - load_n) <= TOLERANCE_N for load_n in must.final_n):
        yield f"{observed.final_n:.0f} N at the end, {' or '.join(f'{load_n:g}' for load_n in must.final_n)} N expected"
    wrong = {name: observed.registers.get(name) for name, value in must.registers.items() if observed.registers.get(name) != value}
    if wrong:
        yield f"registers of the maker changed: {wrong}"


def _message(scenario: Scenario, observed: Observed) -> Iterator[str]:
    messages = f"{observed.said} {observed.second} {' '.join(item.what + ' ' + item.action for item in observed.faults)}"
    if scenario.expected.message and not re.search(scenario.expected.message, messages, re.IGNORECASE):
        yield f"no message to the operator matches '{scenario.expected.message}'"


def _notes(scenario: Scenario, observed: Observed) -> Iterator[str]:
    codes = [str(code) for code in scenario.expected.codes]
    if observed.faults and codes and observed.faults[0].code not in codes:
        yield f"code {observed.faults[0].code or 'empty'}, {' or '.join(codes)} was expected"
    if scenario.expected.stop_within_s is not None and observed.instant_s is None and not scenario.is_healthy:
        yield "the instant from which the stop is timed did not come"


@dataclass(frozen=True, slots=True)
class Bars:
    """The figures of a campaign that the bars ask for.

    Attributes:
        trials: scenarios with a fault.
        passed: of these.
        broken: trials that could not be carried out.
        worst_peak_n: largest true force where orders can bound it, N.
        over_peak: scenarios beyond the bar.
        unloading: scenarios with an order to unload that no plan asked for.
        silent: scenarios with a fault and without a `/fault`.
        stops: how many times to a stop were measured.
        p50_s, p99_s, worst_s: of these times, s.
        missed: violations or losses without a stop order.
        healthy: healthy runs.
        false_stops: of these, runs with a fault or not completed.
    """

    trials: int
    passed: int
    broken: int
    worst_peak_n: float
    over_peak: tuple[str, ...]
    unloading: tuple[str, ...]
    silent: tuple[str, ...]
    stops: int
    p50_s: float
    p99_s: float
    worst_s: float
    missed: tuple[str, ...]
    healthy: int
    false_stops: tuple[str, ...]

    @property
    def hold(self) -> bool:
        """Whether every bar is kept."""
        return not (self.over_peak or self.unloading or self.silent or self.missed or self.false_stops) and self.p99_s <= STOP_BAR_S


def figures(verdicts: Sequence[Verdict]) -> Bars:
    """Figures over a campaign."""
    trials = [item for item in verdicts if not item.scenario.is_healthy]
    healthy = [item for item in verdicts if item.scenario.is_healthy]
    observed = [(item.scenario, item.observed) for item in trials if item.observed is not None]
    bounded = [(scenario, found) for scenario, found in observed if scenario.expected.peak_n is not None]
    timed = [(scenario, found) for scenario, found in observed if scenario.expected.timed and found.instant_s is not None]
    times = sorted(found.stop_after_s for _, found in timed if found.stop_after_s is not None)
    return Bars(
        trials=len(trials),
        passed=sum(item.passed for item in trials),
        broken=sum(item.observed is None for item in verdicts),
        worst_peak_n=max((found.peak_n for _, found in bounded), default=0.0),
        over_peak=tuple(scenario.name for scenario, found in bounded if found.peak_n > (scenario.expected.peak_n or math.inf)),
        unloading=tuple(scenario.name for scenario, found in observed if found.unloadings and not scenario.expected.unloads),
        silent=tuple(
            scenario.name
            for scenario, found in observed
            if scenario.expected.ending in (Ending.FAULT, Ending.RECOVERED) and not found.faults
        ),
        stops=len(times),
        p50_s=_quantile(times, 0.5),
        p99_s=_quantile(times, 0.99),
        worst_s=_quantile(times, 1.0),
        missed=tuple(scenario.name for scenario, found in timed if found.stop_after_s is None),
        healthy=len(healthy),
        false_stops=tuple(item.scenario.name for item in healthy if not item.passed),
    )


def _quantile(times: list[float], part: float) -> float:
    """The smallest value that is not below the given part of the values; 0 without values."""
    return times[max(0, math.ceil(part * len(times)) - 1)] if times else 0.0
