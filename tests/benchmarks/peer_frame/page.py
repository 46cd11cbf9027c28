"""Lines for the terminal, and the page docs/validation/load-frame-safety.md."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from statistics import median

from .building import ROOT
from .scenario import PEAK_MAX_N, STOP_BAR_S, Group
from .verdict import Bars, Verdict

PAGE = ROOT / "docs" / "validation" / "load-frame-safety.md"
_COLUMNS = ("scenario", "what happened", "must", "true peak, N", "stop on the wire", "fault code", "what the operator saw", "verdict")


def line(verdict: Verdict) -> str:
    """A scenario in a line of the terminal."""
    observed, name = verdict.observed, verdict.scenario.name
    mark = "pass" if verdict.passed else "FAIL"
    if observed is None:
        return f"{mark} {name:34} {verdict.failings[0]}"
    why = "; ".join((*verdict.failings, *(f"note: {note}" for note in verdict.notes)))
    figures = f"peak {observed.peak_n:6.1f} N, stop {stop_time(verdict):>7}, {len(observed.stops_s):3} stops, code {_code(verdict)}"
    ending = f"exit {observed.exit_code}, pairs {observed.loaded_pairs}, {observed.wall_s:4.1f} s"
    return f"{mark} {name:34} {figures}, {ending} | {why or 'as it must be'} | {operator_text(verdict)[:200]}"


def stop_time(verdict: Verdict) -> str:
    """From the violation, the loss or the fault to the first stop order on the wire; ``-`` where none is needed."""
    observed, must = verdict.observed, verdict.scenario.expected
    if observed is None or observed.instant_s is None or must.stop_within_s is None:
        return "-"
    return "none" if observed.stop_after_s is None else f"{observed.stop_after_s:.2f} s"


def _code(verdict: Verdict) -> str:
    observed = verdict.observed
    return "-" if observed is None or not observed.faults else observed.faults[0].code or "empty"


def operator_text(verdict: Verdict) -> str:
    """Message to the operator: the first fault, or else the last output; paths and addresses are shortened."""
    observed = verdict.observed
    if observed is None:
        return ""
    text = observed.faults[0].what if observed.faults else observed.said[-220:]
    if not observed.faults and (observed.exit_code == 2 or "second run" in observed.second):
        text = observed.second or observed.said[-300:]
    text = re.sub(r"/\S*/", "", text)
    return " ".join(re.sub(r"127\.0\.0\.1:\d+", "the device", text).split())


def _listed(names: Sequence[str]) -> str:
    return f"{len(names)}{': ' + ', '.join(names) if names else ''}"


def summary(bars: Bars) -> str:
    """The bars, one a line."""
    times = f"n {bars.stops}, median {bars.p50_s:.3f} s, p99 {bars.p99_s:.3f} s, worst {bars.worst_s:.3f} s"
    peak = f"{bars.worst_peak_n:.1f} N (bar {PEAK_MAX_N:g} N)"
    return "\n".join(
        (
            f"scenarios with a fault: {bars.passed} of {bars.trials} as they must be, {bars.broken} not carried out",
            f"largest true force where orders can bound it: {peak}; beyond: {_listed(bars.over_peak)}",
            f"orders to unload that no plan asked for: {_listed(bars.unloading)}",
            f"scenarios without a /fault: {_listed(bars.silent)}",
            f"violation or loss to stop on the wire: {times} (bar for p99 {STOP_BAR_S:g} s); without a stop: {_listed(bars.missed)}",
            f"healthy runs: {bars.healthy}, false stops: {_listed(bars.false_stops)}",
        )
    )


def _cell(text: str) -> str:
    """Text that does not break a table."""
    return " ".join(text.replace("|", "/").replace("<", "&lt;").split())


def _row(verdict: Verdict) -> str:
    item, observed = verdict.scenario, verdict.observed
    peak = "" if observed is None else f"{observed.peak_n:.0f}"
    found = "as it must be" if verdict.passed else f"**failed**: {'; '.join(verdict.failings)}"
    cells = (item.name, item.what, item.must, peak, stop_time(verdict), _code(verdict), operator_text(verdict)[:220], found)
    return f"| {' | '.join(_cell(cell) for cell in cells)} |"


def _healthy(verdicts: Sequence[Verdict]) -> Iterator[str]:
    yield "| kind | runs | completed | in displacement control | false stops |"
    yield "|---|---|---|---|---|"
    kinds: dict[str, list[Verdict]] = {}
    for item in verdicts:
        kinds.setdefault(item.scenario.what.partition(":")[0], []).append(item)
    for kind, runs in kinds.items():
        disp = sum(item.scenario.is_displacement for item in runs)
        wrong = [f"{item.scenario.name}: {'; '.join(item.failings)}" for item in runs if not item.passed]
        yield f"| {kind} | {len(runs)} | {sum(item.passed for item in runs)} | {disp} | {_cell('; '.join(wrong)) or 0} |"


def _circumstances(verdicts: Sequence[Verdict]) -> str:
    """How many processors there were, how busy they were at the end, and how long a trial took."""
    observed = [item.observed for item in verdicts if item.observed is not None]
    walls, starts = ([getattr(item, name) for item in observed] or [0.0] for name in ("wall_s", "start_s"))
    computer = f"{os.cpu_count()} processors, load average {os.getloadavg()[0]:.1f}"
    return f"({computer}; a trial took {median(walls):.0f} s, of which the start of the daemon {median(starts):.0f} s, in the median):"


def _between(text: str, mark: str, new: str) -> str:
    """Replace the text between two marks."""
    head, begin, rest = text.partition(f"<!-- {mark} -->\n")
    _, end, tail = rest.partition(f"\n<!-- end of {mark} -->")
    if not (begin and end):
        raise ValueError(f"{PAGE} has no marks around {mark}; restore the page from the repository")
    return head + begin + new + end + tail


def write(verdicts: Sequence[Verdict], bars: Bars, options: Sequence[str]) -> None:
    """Write figures and tables into the page.

    Raises:
        ValueError: the page has lost its marks.
    """
    text = PAGE.read_text(encoding="utf-8")
    command = " ".join(("python tests/benchmarks/bench_peer_frame.py", *options))
    text = _between(
        text, "figures", "\n".join([f"Written by `{command}`.", "", *(f"- {_cell(item)}" for item in summary(bars).splitlines())])
    )
    for group, mark in ((Group.README, "list"), (Group.OWN, "own")):
        rows = [_row(item) for item in verdicts if item.scenario.group is group]
        text = _between(
            text, mark, "\n".join((f"| {' | '.join(_COLUMNS)} |", "|---" * len(_COLUMNS) + "|", *rows)) if rows else "None was run."
        )
    runs = [item for item in verdicts if item.scenario.group is Group.HEALTHY]
    text = _between(text, "healthy", "\n".join(_healthy(runs)) if runs else "None was run.")
    PAGE.write_text(text, encoding="utf-8")


def write_maps(verdicts: Sequence[Verdict], bars: Bars, options: str) -> None:
    """Write the section of the shipped maps and drivers into the page; the other sections are not changed.

    Args:
        verdicts: all of them.
        bars: their figures.
        options: of the command line, without paths.

    Raises:
        ValueError: the page has lost its marks.
    """
    command = f"python tests/benchmarks/bench_every_map.py {options}"
    rows = [_row(item) for item in verdicts]
    head = (f"| {' | '.join(_COLUMNS)} |", "|---" * len(_COLUMNS) + "|")
    lines = (
        f"Written by `{command}` {_circumstances(verdicts)}",
        "",
        *(f"- {_cell(item)}" for item in summary(bars).splitlines()),
        "",
        *head,
        *rows,
    )
    PAGE.write_text(_between(PAGE.read_text(encoding="utf-8"), "maps", "\n".join(lines)), encoding="utf-8")
