"""The comparison as rows: quantity | paper | semlive | bar | gauge length at which the paper's figure is reached."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from sidebyside import facts
from sidebyside.facts import PaperFigures
from sidebyside.measure import COMPONENTS, GaugeRow, PhaseFigures, RunFigures

NOTHING = "–"
DISPLACEMENTS = ("u", "v")


@dataclass(frozen=True)
class Row:
    """One line of the table; `held` is None where no bar is set."""

    quantity: str
    paper: str
    semlive: str
    bar: str = NOTHING
    held: bool | None = None
    gauge: str = NOTHING

    def markdown(self) -> str:
        word = "" if self.held is None else (" **held**" if self.held else " **missed**")
        return f"| {self.quantity} | {self.paper} | {self.semlive} | {self.bar}{word} | {self.gauge} |"


def rows(figures: RunFigures, paper: PaperFigures) -> list[Row]:
    """Every row of one experiment."""
    return [
        *_displacement(figures, paper),
        *_fields(figures, paper),
        *_strains(figures, paper),
        *_noise(figures),
        *_elastic(figures, paper),
    ]


def markdown(figures: RunFigures, paper: PaperFigures) -> str:
    """The table."""
    head = "| quantity | paper | semlive | bar | virtual strain gauge at which the paper's figure is reached |\n|---|---|---|---|---|"
    return "\n".join([head, *(row.markdown() for row in rows(figures, paper))])


def curve_markdown(figures: RunFigures) -> str:
    """Scatter against gauge length, all frames and components together."""
    lines = [
        "| points | gauge (px) | displacement sd (px) | strain sd | displacement: ratio to DIC noise | strain: ratio | chance (1 sd) "
        "| correction: displacement (px) | strain |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for at, row in enumerate(_any_phase(figures).curve):
        if row.window_points not in facts.CURVE_WINDOWS:
            continue
        u, e = pooled(figures, at, DISPLACEMENTS), pooled(figures, at, COMPONENTS)
        numbers = (_px(u.measured), strain_text(e.measured), f"{u.ratio:.2f}", f"{e.ratio:.2f}", f"± {e.chance:.2f}")
        shares = (_px(u.correction), strain_text(e.correction))
        lines.append(f"| {row.window_points} | {row.vsg_px} | " + " | ".join((*numbers, *shares)) + " |")
    return "\n".join(lines)


@dataclass(frozen=True)
class Pooled:
    """One gauge length, root mean square over all frames and over some components."""

    measured: float
    predicted: float
    correction: float
    chance: float

    @property
    def ratio(self) -> float:
        return self.measured / self.predicted


def pooled(figures: RunFigures, at: int, names: tuple[str, ...]) -> Pooled:
    """All phases of a run at one place of the curve, each phase as often as it has frames."""
    weights = [len(phase.error) for phase in figures.phases.values()]
    lines = [phase.curve[at] for phase in figures.phases.values()]

    def rms(part: str) -> float:
        squares = [np.mean([getattr(line, part)[name] ** 2 for name in names]) for line in lines]
        return float(np.sqrt(np.average(squares, weights=weights)))

    # u and v are independent, the three strains hold two independent components; frame 0 is in every phase.
    return Pooled(rms("measured"), rms("predicted"), rms("correction"), min(line.chance for line in lines) / float(np.sqrt(2)))


def correction_share(figures: RunFigures) -> dict[str, float]:
    """Of each strain component, the correction's share of its scatter over the stated gauge, root mean square over all frames."""
    at = next(i for i, row in enumerate(_any_phase(figures).curve) if row.window_points == facts.STATED_WINDOW)
    return {name: pooled(figures, at, (name,)).correction for name in COMPONENTS}


def worst_ratio(figures: RunFigures, names: tuple[str, ...]) -> tuple[float, float, int]:
    """Largest ratio to the DIC's noise along the curve, what chance allows there, and the gauge length."""
    found = []
    for at, row in enumerate(_any_phase(figures).curve):
        if row.window_points in facts.CURVE_WINDOWS:
            item = pooled(figures, at, names)
            found.append((item.ratio, item.chance, row.vsg_px))
    return max(found)


def reached_at(curve: tuple[GaugeRow, ...], figure: float) -> str:
    """Gauge length from which on the scatter of every component stays below a figure, log-log interpolated."""
    length = np.log([row.vsg_px for row in curve])
    scatter = np.log([max(row.measured[name] for name in COMPONENTS) for row in curve])
    above = np.flatnonzero(scatter > np.log(figure))
    if not above.size:
        return f"≤ {curve[0].vsg_px} px"
    last = int(above[-1])
    if last == len(curve) - 1:
        return f"> {curve[-1].vsg_px} px"
    part = (scatter[last] - np.log(figure)) / (scatter[last] - scatter[last + 1])
    return f"{float(np.exp(length[last] + part * (length[last + 1] - length[last]))):.0f} px"


def _displacement(figures: RunFigures, paper: PaperFigures) -> Iterator[Row]:
    ratio = figures.displacement_rms_px / figures.stated_sigma_px
    yield Row(
        "displacement sd, each point (43 px subset)", paper.displacement_reported,
        f"{_px(figures.displacement_rms_px)} px; DIC states {_px(figures.stated_sigma_px)} px, ratio {ratio:.3f}",
        f"≤ {facts.RATIO_BAR} × DIC noise", ratio <= facts.RATIO_BAR,
    )  # fmt: skip
    part = 100 * (figures.correction_rms_px / figures.displacement_rms_px) ** 2
    yield Row("contribution of the correction", NOTHING, f"{_px(figures.correction_rms_px)} px rms ({part:.1f} % of the variance)")


def _fields(figures: RunFigures, paper: PaperFigures) -> Iterator[Row]:
    item = figures.errors.distortion
    if not item.valid.any():
        yield Row("distortion residual", paper.distortion_reported, "not determined", "", held=False)
    else:
        error, allowed = item.error_px[item.valid], facts.DISTORTION_BAR_PX
        largest, rms = float(np.abs(error).max()), float(np.sqrt(np.mean(error**2)))
        yield Row(
            "distortion residual, its affine part removed", paper.distortion_reported, f"max {_px(largest)} px, rms {_px(rms)} px",
            f"≤ {allowed:.2f} px", largest <= allowed,
        )  # fmt: skip
    drift = np.array([np.abs(part.true_px[-1] - part.true_px[0]).max() for part in figures.errors.drift])
    error = np.concatenate([part.error_px for part in figures.errors.drift])
    true = f"true drift across a frame up to {drift.max():.2f} px"
    yield Row("drift within frames, error", NOTHING, f"rms {_px(float(np.sqrt(np.mean(error**2))))} px ({true})")


def _strains(figures: RunFigures, paper: PaperFigures) -> Iterator[Row]:
    for name, phase in figures.phases.items():
        at = next(i for i, row in enumerate(phase.curve) if row.window_points == facts.STATED_WINDOW)
        row = phase.curve[at]
        largest = float(np.abs(phase.error).max())
        label = "error of the mean strain" if name == "tension" else "mean strain"
        bar = paper.strain_mean.get(name)
        rms = float(np.sqrt(np.mean(phase.error**2)))
        yield Row(
            f"{label}, {name}, worst of {len(phase.error)} frames × 3 components",
            paper.strain_mean_reported.get(name, "no figure"),
            f"{strain_text(largest)} (rms {strain_text(rms)}; uncorrected {strain_text(_worst(phase))})",
            NOTHING if bar is None else f"≤ {strain_text(bar)}",
            None if bar is None else largest <= bar,
        )
        sd = ", ".join(f"{c} {strain_text(row.measured[c])}" for c in COMPONENTS)
        figure = paper.strain_sd.get(name)
        gauge = NOTHING if figure is None else f"{strain_text(figure)} at {reached_at(phase.curve, figure)}"
        ratio = max(row.ratio(c) for c in COMPONENTS)
        yield Row(
            f"strain sd over a {row.vsg_px} px gauge, {name}", paper.strain_sd_reported.get(name, "no figure"),
            f"{sd}; ≤ {ratio:.2f} × DIC noise", f"≤ {facts.RATIO_BAR} × DIC noise", ratio <= facts.RATIO_BAR, gauge,
        )  # fmt: skip
        share, allowed = max(row.correction[c] for c in COMPONENTS), facts.CORRECTION_SD_BAR
        yield Row(
            f"contribution of the correction, {name}", NOTHING,
            f"sd {strain_text(share)}, mean ≤ {strain_text(float(np.abs(phase.correction).max()))}",
            f"sd ≤ {strain_text(allowed)}", share <= allowed,
        )  # fmt: skip
    worst = max(correction_share(figures).values())
    yield Row(
        "contribution of the correction, all frames, worst component (as in estimation.md)", NOTHING,
        f"sd {strain_text(worst)}", f"sd ≤ {strain_text(facts.CORRECTION_SD_BAR)}", worst <= facts.CORRECTION_SD_BAR,
    )  # fmt: skip


def _noise(figures: RunFigures) -> Iterator[Row]:
    for label, names in (("displacement", DISPLACEMENTS), ("strain", COMPONENTS)):
        ratio, chance, vsg_px = worst_ratio(figures, names)
        yield Row(
            f"{label} sd against DIC noise, worst over the curve of gauge lengths", NOTHING,
            f"{ratio:.2f} ± {chance:.2f} by chance, at {vsg_px} px", f"≤ {facts.RATIO_BAR}", ratio <= facts.RATIO_BAR,
        )  # fmt: skip


def _elastic(figures: RunFigures, paper: PaperFigures) -> Iterator[Row]:
    if figures.elastic is None:
        yield Row("Young's modulus, Poisson's ratio", f"{paper.youngs_modulus_gpa} GPa, {paper.poissons_ratio}", "none", "", held=False)
        return
    modulus, ratio = figures.elastic.youngs_modulus_gpa, figures.elastic.poissons_ratio
    true_modulus, true_ratio = figures.true_elastic
    off = abs(modulus.value - true_modulus)
    yield Row(
        "Young's modulus", paper.modulus_reported,
        f"{modulus.value:.2f} ± {modulus.sigma:.2f} GPa (true {true_modulus} GPa)",
        f"within {facts.MODULUS_BAR_GPA} GPa", off <= facts.MODULUS_BAR_GPA,
    )  # fmt: skip
    yield Row(
        "Poisson's ratio", f"{paper.poissons_ratio} (literature 0.28 to 0.35)",
        f"{ratio.value:.4f} ± {ratio.sigma:.4f} (true {true_ratio})",
        f"within {facts.RATIO_OF_POISSON_BAR}", abs(ratio.value - true_ratio) <= facts.RATIO_OF_POISSON_BAR,
    )  # fmt: skip


def _worst(phase: PhaseFigures) -> float:
    return float(np.abs(phase.uncorrected).max())


def _any_phase(figures: RunFigures) -> PhaseFigures:
    return next(iter(figures.phases.values()))


def _px(value: float) -> str:
    return f"{value:.4f}" if value < 0.1 else f"{value:.2f}"


def strain_text(value: float) -> str:
    """As 1.2e-5."""
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(exponent)}"
