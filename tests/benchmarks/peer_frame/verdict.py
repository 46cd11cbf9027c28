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


def judge(scenario: Scenario, seen: Observed) -> Verdict:
    """Compare what was seen with what must happen."""
    failings = (*_ending(scenario, seen), *_stop(scenario, seen), *_load(scenario, seen), *_message(scenario, seen))
    return Verdict(scenario, seen, tuple(failings), tuple(_notes(scenario, seen)))


def _ending(scenario: Scenario, seen: Observed) -> Iterator[str]:
    must = scenario.expected
    match must.ending:
        case Ending.COMPLETE:
            if seen.exit_code != 0:
                yield f"did not complete (exit status {seen.exit_code})"
            if seen.faults:
                yield f"{len(seen.faults)} faults"
        case Ending.FAULT:
            if not seen.faults:
                yield "no /fault"
            elif not seen.faults[0].code:
                yield "/fault without a code"
            if seen.exit_code == 0:
                yield "run complete, exit status 0"
        case Ending.REFUSED:
            if seen.moved:
                yield "motion was ordered"
            if seen.exit_code not in (1, 2):
                yield f"not refused (exit status {seen.exit_code})"
            elif seen.exit_code == 1 and not seen.faults:
                yield "ended without a /fault"
            elif seen.exit_code == 1 and not seen.faults[0].code:
                yield "/fault without a code"
        case Ending.ASKED:
            if not (seen.asked or seen.faults or seen.exit_code == 2):
                yield "the operator was not asked"
        case Ending.RECOVERED:
            if not seen.faults:
                yield "no /fault"
            if seen.exit_code != 0:
                yield f"did not complete after the operator resumed (exit status {seen.exit_code})"
        case Ending.STOPPED:
            if seen.exit_code == 0:
                yield "run complete, exit status 0"
        case Ending.SAFE:
            pass
    if seen.exit_code is None:
        yield "had to be killed"
    if "Traceback" in seen.said:
        yield "a traceback reached the terminal"
    if "semlive itself failed" in seen.said:
        yield "ended with an internal error"


def _stop(scenario: Scenario, seen: Observed) -> Iterator[str]:
    must = scenario.expected
    if must.stop_within_s is not None and must.ending in _STOPS and seen.instant_s is not None:
        if seen.stop_after_s is None:
            yield "no stop order"
        elif seen.stop_after_s > must.stop_within_s:
            yield f"stop order after {seen.stop_after_s:.2f} s, {must.stop_within_s:g} s are allowed"
        if seen.silence_s > REPEAT_S:
            yield f"moved for {seen.silence_s:.1f} s without a further stop order"
    if must.no_orders and must.ending in (Ending.FAULT, Ending.ASKED, Ending.STOPPED) and _orders_after(scenario, seen):
        yield f"{seen.orders} motions ordered after the fault"


def _orders_after(scenario: Scenario, seen: Observed) -> bool:
    # A displacement drive is moved by short travels, which go on until the fault is found.
    return seen.orders > 0 and not scenario.is_displacement


def _load(scenario: Scenario, seen: Observed) -> Iterator[str]:
    must = scenario.expected
    if must.peak_n is not None and seen.peak_n > must.peak_n:
        yield f"peak {seen.peak_n:.0f} N, {must.peak_n:.0f} N are allowed"
    if seen.unloadings and not must.unloads:
        yield f"ordered to unload: {seen.unloadings[0]}"
    if must.loaded_pairs is not None and seen.loaded_pairs != must.loaded_pairs:
        yield f"{seen.loaded_pairs} pairs under load accepted, {must.loaded_pairs} expected"
    if must.final_n and not any(abs(seen.final_n - load_n) <= TOLERANCE_N for load_n in must.final_n):
        yield f"{seen.final_n:.0f} N at the end, {' or '.join(f'{load_n:g}' for load_n in must.final_n)} N expected"
    wrong = {name: seen.registers.get(name) for name, value in must.registers.items() if seen.registers.get(name) != value}
    if wrong:
        yield f"registers of the maker changed: {wrong}"


def _message(scenario: Scenario, seen: Observed) -> Iterator[str]:
    said = f"{seen.said} {seen.second} {' '.join(one.what + ' ' + one.action for one in seen.faults)}"
    if scenario.expected.says and not re.search(scenario.expected.says, said, re.IGNORECASE):
        yield f"the operator is not told '{scenario.expected.says}'"


def _notes(scenario: Scenario, seen: Observed) -> Iterator[str]:
    codes = [str(code) for code in scenario.expected.codes]
    if seen.faults and codes and seen.faults[0].code not in codes:
        yield f"code {seen.faults[0].code or 'empty'}, {' or '.join(codes)} was expected"
    if scenario.expected.stop_within_s is not None and seen.instant_s is None and not scenario.is_healthy:
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
    trials = [one for one in verdicts if not one.scenario.is_healthy]
    healthy = [one for one in verdicts if one.scenario.is_healthy]
    seen = [(one.scenario, one.observed) for one in trials if one.observed is not None]
    bounded = [(scenario, found) for scenario, found in seen if scenario.expected.peak_n is not None]
    timed = [(scenario, found) for scenario, found in seen if scenario.expected.timed and found.instant_s is not None]
    times = sorted(found.stop_after_s for _, found in timed if found.stop_after_s is not None)
    return Bars(
        trials=len(trials),
        passed=sum(one.passed for one in trials),
        broken=sum(one.observed is None for one in verdicts),
        worst_peak_n=max((found.peak_n for _, found in bounded), default=0.0),
        over_peak=tuple(scenario.name for scenario, found in bounded if found.peak_n > (scenario.expected.peak_n or math.inf)),
        unloading=tuple(scenario.name for scenario, found in seen if found.unloadings and not scenario.expected.unloads),
        silent=tuple(
            scenario.name for scenario, found in seen if scenario.expected.ending in (Ending.FAULT, Ending.RECOVERED) and not found.faults
        ),
        stops=len(times),
        p50_s=_quantile(times, 0.5),
        p99_s=_quantile(times, 0.99),
        worst_s=_quantile(times, 1.0),
        missed=tuple(scenario.name for scenario, found in timed if found.stop_after_s is None),
        healthy=len(healthy),
        false_stops=tuple(one.scenario.name for one in healthy if not one.passed),
    )


def _quantile(times: list[float], part: float) -> float:
    """The smallest value that is not below the given part of the values; 0 without values."""
    return times[max(0, math.ceil(part * len(times)) - 1)] if times else 0.0
