"""Lines for the terminal, and the page docs/safety-campaign.md."""

from __future__ import annotations

import re
from collections.abc import Sequence

from .building import ROOT
from .scenario import PEAK_MAX_N, STOP_BAR_S, Ending
from .verdict import Bars, Verdict

PAGE = ROOT / "docs" / "safety-campaign.md"


def line(verdict: Verdict) -> str:
    """A scenario in a line of the terminal."""
    seen, name = verdict.observed, verdict.scenario.name
    mark = "pass" if verdict.passed else "FAIL"
    if seen is None:
        return f"{mark} {name:30} {verdict.failings[0]}"
    why = "; ".join((*verdict.failings, *(f"note: {note}" for note in verdict.notes)))
    code = seen.faults[0].code if seen.faults else "-"
    figures = f"peak {seen.peak_n:6.1f} N, stop {_stop(verdict):>7}, {len(seen.stops_s):3} stops, code {code or 'empty'}"
    ending = f"exit {seen.exit_code}, pairs {seen.loaded_pairs}, {seen.wall_s:4.1f} s"
    return f"{mark} {name:30} {figures}, {ending} | {why or 'as it must be'} | {_said(verdict)[:200]}"


def _stop(verdict: Verdict) -> str:
    seen = verdict.observed
    if seen is None or seen.instant_s is None:
        return "-"
    return "none" if seen.stop_after_s is None else f"{seen.stop_after_s:.2f} s"


def _said(verdict: Verdict) -> str:
    """What the operator was told: the first fault, or else what was printed last."""
    seen = verdict.observed
    if seen is None:
        return ""
    text = seen.faults[0].what if seen.faults else seen.said[-220:]
    return " ".join(re.sub(r"/\S*/", "", text).split())


def summary(bars: Bars) -> str:
    """The bars in a few lines."""

    def listed(names: Sequence[str]) -> str:
        return f"{len(names)}{': ' + ', '.join(names) if names else ''}"

    return "\n".join(
        (
            f"scenarios with a fault: {bars.passed} of {bars.trials} as they must be, {bars.broken} not carried out",
            f"largest true force where orders can bound it: {bars.worst_peak_n:.1f} N (bar {PEAK_MAX_N:g} N); beyond: {listed(bars.over_peak)}",
            f"unloading that no plan asked for: {listed(bars.unloading)}",
            f"scenarios without a /fault: {listed(bars.silent)}",
            f"violation or loss to stop on the wire: n {bars.stops}, median {bars.p50_s:.3f} s, p99 {bars.p99_s:.3f} s, worst {bars.worst_s:.3f} s "
            f"(bar {STOP_BAR_S:g} s); without a stop: {listed(bars.missed)}",
            f"healthy runs: {bars.healthy}, false stops: {listed(bars.false_stops)}",
        )
    )


def write(verdicts: Sequence[Verdict], bars: Bars, options: Sequence[str]) -> None:
    """Write the page."""
    raise NotImplementedError(Ending.SAFE, verdicts, bars, options)
