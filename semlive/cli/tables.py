"""Tables that commands print."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table

from semlive.data.results import RunResult
from semlive.data.strain import StrainSummary
from semlive.report.score import Score


def score_table(scores: Sequence[Score], *, everything: bool = False) -> Table:
    """Recovered beside true, each with its uncertainty and whether the truth lies within it; by default without every frame and pair."""
    scores = [one for one in scores if everything or not one.detail]
    wrong = sum(not one.inside(0.95) for one in scores)
    held = f"{len(scores) - wrong} of {len(scores)} within the stated 95 %; an rms error is held against the rms of the stated"
    # One line each on a terminal of 80 columns: no frame between columns, the unit beside the name, the error left to --json.
    table = Table(title="recovered against true", caption=held, box=SIMPLE_HEAD, padding=0)
    table.add_column("quantity", no_wrap=True, max_width=42)
    for name in ("true", "recovered", "± sigma"):
        table.add_column(name, justify="right", no_wrap=True, min_width=9)
    table.add_column("in", no_wrap=True, min_width=4)
    for one in scores:
        inside = "68 %" if one.inside(0.6827) else "95 %" if one.inside(0.95) else "no"
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
    for frame in result.frames:
        summary = frame.summary
        decision = decisions[summary.frame // 2]
        load = f"{decision.loads[summary.frame % 2].mean_n:.1f}" if decision.loads else ""
        table.add_row(str(summary.frame), decision.step.phase.value, load, *(_strain(summary, c) for c in ("exx", "eyy", "exy")))
    return table


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
