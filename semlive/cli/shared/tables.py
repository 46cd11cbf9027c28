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
    """Table of recovered and true values, uncertainties, and whether the true value lies within them.

    Args:
        scores: one for each quantity.
        everything: include the rows of single frames and pairs.
    """
    scores = [score for score in scores if everything or not score.detail]
    outside = sum(not score.covers(0.95) for score in scores)
    caption = f"{len(scores) - outside} of {len(scores)} within the stated 95 %; an rms error is compared with the rms uncertainty"
    # One line for each quantity on a terminal of 80 columns: no lines between columns, the unit behind the name, the error only in --json.
    table = Table(title="recovered and true values", caption=caption, box=SIMPLE_HEAD, padding=0)
    table.add_column("quantity", no_wrap=True, max_width=42)
    for name in ("true", "recovered", "± sigma"):
        table.add_column(name, justify="right", no_wrap=True, min_width=9)
    table.add_column("in", no_wrap=True, min_width=4)
    for score in scores:
        inside = "68 %" if score.covers(0.6827) else "95 %" if score.covers(0.95) else "no"
        numbers = _number(score.truth), _number(score.value), f"{score.sigma:.2g}"
        name = f"{score.name}, {score.unit}" if score.unit else score.name
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


def comparison_table(before: dict[str, Any], after: dict[str, Any], label: str) -> Table:
    """Table of two results: elastic constants, noise, and every frame that both results contain.

    Args:
        before: first result, in the form of `semlive replay --json`.
        after: second result.
        label: heading of the first result.
    """
    table = Table(title=f"{label} and new result", box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("quantity", no_wrap=True)
    for name in (label, "new", "change"):
        table.add_column(name, justify="right", no_wrap=True)
    by_frame = {value["frame"]: value for value in before["frames"]}
    for name, was, now in [*_headline(before, after), *(row for value in after["frames"] for row in _frame_rows(by_frame, value))]:
        change = f"{now - was:+.3g}" if isinstance(was, float | int) and isinstance(now, float | int) else ""
        table.add_row(
            name, *("-" if value is None else value if isinstance(value, str) else f"{value:.6g}" for value in (was, now)), change
        )
    return table


def _headline(before: dict[str, Any], after: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    rows: list[tuple[str, Any, Any]] = [
        (name, before.get(name), after.get(name)) for name in ("pairs", "method", "vsg_px", "noise_floor_px")
    ]
    for axis, name in enumerate("xy"):
        rows.append((f"distortion rms {name}, px", before["distortion"]["rms_px"][axis], after["distortion"]["rms_px"][axis]))
    for key, name in (("youngs_modulus_gpa", "E, GPa"), ("poissons_ratio", "Poisson's ratio")):
        for part in ("value", "sigma"):
            old, new = ((result["elastic"] or {}).get(key, {}).get(part) for result in (before, after))
            rows.append((name if part == "value" else f"± {name}", old, new))
    return rows


def _frame_rows(by_frame: dict[int, dict[str, Any]], new: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    old = by_frame.get(new["frame"])
    if old is None or new["frame"] == 0:
        return []
    return [
        (f"frame {new['frame']} {component}, 1e-6", *(1e6 * frame["strain_mean"][component] for frame in (old, new)))
        for component in ("exx", "eyy", "exy")
    ]


def pair_status_line(decision: PairDecision, state: AnalysisState) -> str:
    """Result of an analysed pair in one line."""
    mean, sigma = state.reported[2 * decision.pair + 1].summary.mean, state.reported[2 * decision.pair + 1].summary.mean_sigma
    strains = "  ".join(
        f"{component} {getattr(mean, component) * 1e6:+.1f} ± {getattr(sigma, component) * 1e6:.1f}" for component in ("exx", "eyy", "exy")
    )
    load = f"  load {decision.loads[1].mean_n:.0f} N" if decision.loads else ""
    elastic = state.elastic[0]
    modulus = "" if elastic is None else f"  E {elastic.youngs_modulus_gpa.value:.2f} ± {elastic.youngs_modulus_gpa.sigma:.2f} GPa"
    return f"pair {decision.pair} {decision.step.phase.value}{load}  {strains} 1e-6{modulus}"


def _elastic_caption(result: RunResult) -> str:
    if result.elastic is None:
        return "no elastic constants: they need tensile steps at two loads and specimen.area_mm2"
    modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
    constants = f"E = {modulus.value:.2f} ± {modulus.sigma:.2f} GPa    Poisson's ratio = {ratio.value:.4f} ± {ratio.sigma:.4f}"
    if result.gage is None:
        return constants
    by_gage, agreement = result.gage.youngs_modulus_gpa, result.gage.dic_over_gage
    gage = f"strain gage: E = {by_gage.value:.2f} ± {by_gage.sigma:.2f} GPa    DIC / gage = {agreement.value:.4f} ± {agreement.sigma:.4f}"
    return f"{constants}\n{gage}"


def _strain(summary: StrainSummary, component: str) -> str:
    return f"{getattr(summary.mean, component) * 1e6:.1f} ± {getattr(summary.mean_sigma, component) * 1e6:.1f}"


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.1f}"
