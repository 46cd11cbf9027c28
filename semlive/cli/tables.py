"""Tables that commands print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from semlive.data.pair import PairDecision
from semlive.data.results import RunResult
from semlive.data.strain import StrainSummary
from semlive.pipeline import AnalysisState
from semlive.report.scoring.score import Score


def score_table(scores: Sequence[Score], *, everything: bool = False) -> Table:
    """Recovered beside true, each with its uncertainty and whether the truth lies within it; by default without every frame and pair."""
    scores = [one for one in scores if everything or not one.detail]
    wrong = sum(not one.covers(0.95) for one in scores)
    held = f"{len(scores) - wrong} of {len(scores)} within the stated 95 %; an rms error is held against the rms of the stated"
    # One line each on a terminal of 80 columns: no frame between columns, the unit beside the name, the error left to --json.
    table = Table(title="recovered against true", caption=held, box=SIMPLE_HEAD, padding=0)
    table.add_column("quantity", no_wrap=True, max_width=42)
    for name in ("true", "recovered", "± sigma"):
        table.add_column(name, justify="right", no_wrap=True, min_width=9)
    table.add_column("in", no_wrap=True, min_width=4)
    for one in scores:
        inside = "68 %" if one.covers(0.6827) else "95 %" if one.covers(0.95) else "no"
        numbers = _number(one.truth), _number(one.value), f"{one.sigma:.2g}"
        name = f"{one.name}, {one.unit}" if one.unit else one.name
        table.add_row(name.replace(", the worst of", ", worst of"), *numbers, inside, style="bold red" if inside == "no" else None)
    return table


def result_table(result: RunResult) -> Table:
    """Mean strain of every accepted frame with its uncertainty, and the elastic constants below."""
    table = Table(title="corrected strain, relative to frame 0", caption=_elastic_caption(result))
    for name in ("frame", "phase", "load N", "exx 1e-6", "eyy 1e-6", "exy 1e-6"):
        table.add_column(name, justify="left" if name == "phase" else "right")
    decisions = {decision.pair: decision for decision in result.decisions}
    for summary in result.summaries:
        decision = decisions[summary.frame // 2]
        load = f"{decision.loads[summary.frame % 2].mean_n:.1f}" if decision.loads else ""
        table.add_row(str(summary.frame), decision.step.phase.value, load, *(_strain(summary, c) for c in ("exx", "eyy", "exy")))
    return table


def comparison_table(before: dict[str, Any], after: dict[str, Any], beside: str) -> Table:
    """Two results side by side, as `semlive replay --json` words them: constants, noise, and every frame that both have."""
    table = Table(title=f"{beside} against now", box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("quantity", no_wrap=True)
    for name in (beside, "now", "change"):
        table.add_column(name, justify="right", no_wrap=True)
    known = {one["frame"]: one for one in before["frames"]}
    for name, was, now in [*_headline(before, after), *(row for one in after["frames"] for row in _frame_rows(known, one))]:
        change = f"{now - was:+.3g}" if isinstance(was, float | int) and isinstance(now, float | int) else ""
        table.add_row(name, *("-" if one is None else one if isinstance(one, str) else f"{one:.6g}" for one in (was, now)), change)
    return table


def _headline(before: dict[str, Any], after: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    rows: list[tuple[str, Any, Any]] = [
        (name, before.get(name), after.get(name)) for name in ("pairs", "method", "vsg_px", "noise_floor_px")
    ]
    for axis, name in enumerate("xy"):
        rows.append((f"distortion rms {name}, px", before["distortion"]["rms_px"][axis], after["distortion"]["rms_px"][axis]))
    for key, name in (("youngs_modulus_gpa", "E, GPa"), ("poissons_ratio", "Poisson's ratio")):
        for part in ("value", "sigma"):
            was, now = ((one["elastic"] or {}).get(key, {}).get(part) for one in (before, after))
            rows.append((name if part == "value" else f"± {name}", was, now))
    return rows


def _frame_rows(known: dict[int, dict[str, Any]], now: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    was = known.get(now["frame"])
    if was is None or now["frame"] == 0:
        return []
    return [(f"frame {now['frame']} {one}, 1e-6", *(1e6 * of["strain_mean"][one] for of in (was, now))) for one in ("exx", "eyy", "exy")]


def pair_status_line(decision: PairDecision, begun: AnalysisState) -> str:
    """What is known of a pair as soon as it is analysed, in one line."""
    mean, sigma = begun.reported[2 * decision.pair + 1].summary.mean, begun.reported[2 * decision.pair + 1].summary.mean_sigma
    strains = "  ".join(f"{one} {getattr(mean, one) * 1e6:+.1f} ± {getattr(sigma, one) * 1e6:.1f}" for one in ("exx", "eyy", "exy"))
    load = f"  load {decision.loads[1].mean_n:.0f} N" if decision.loads else ""
    elastic = begun.elastic[0]
    found = "" if elastic is None else f"  E {elastic.youngs_modulus_gpa.value:.2f} ± {elastic.youngs_modulus_gpa.sigma:.2f} GPa"
    return f"pair {decision.pair} {decision.step.phase.value}{load}  {strains} 1e-6{found}"


def _elastic_caption(result: RunResult) -> str:
    if result.elastic is None:
        return "no elastic constants: they need tensile steps at two loads and specimen.area_mm2"
    modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
    found = f"E = {modulus.value:.2f} ± {modulus.sigma:.2f} GPa    Poisson's ratio = {ratio.value:.4f} ± {ratio.sigma:.4f}"
    if result.gage is None:
        return found
    by_gage, agreement = result.gage.youngs_modulus_gpa, result.gage.dic_over_gage
    told = f"strain gage: E = {by_gage.value:.2f} ± {by_gage.sigma:.2f} GPa    DIC / gage = {agreement.value:.4f} ± {agreement.sigma:.4f}"
    return f"{found}\n{told}"


def _strain(summary: StrainSummary, component: str) -> str:
    return f"{getattr(summary.mean, component) * 1e6:.1f} ± {getattr(summary.mean_sigma, component) * 1e6:.1f}"


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.1f}"
