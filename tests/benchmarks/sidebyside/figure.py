"""The curve: scatter of displacement and strain against the length of the virtual strain gauge."""

from __future__ import annotations

import io
import re

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sidebyside.facts import PaperFigures
from sidebyside.measure import COMPONENTS, RunFigures
from sidebyside.table import DISPLACEMENTS, pooled

_INK, _BLUE, _ORANGE, _GREY = "#0f172a", "#2563eb", "#d97706", "#64748b"


def curve_svg(figures: RunFigures, paper: PaperFigures) -> str:
    """Both curves as SVG: measured, predicted from DIC noise alone, and the correction's own share."""
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    _curve(left, figures, DISPLACEMENTS)
    left.set(ylabel="sd of displacement, mean over the gauge (px)", title=f"{paper.title}: displacement")
    _curve(right, figures, COMPONENTS)
    right.set(ylabel="sd of strain", title=f"{paper.title}: strain")
    for name, value in paper.strain_sd.items():
        right.axhline(value, color=_GREY, linestyle=":", linewidth=1.0)
        right.annotate(f"paper, {name}: {value:.1e}", (right.get_xlim()[0], value), xytext=(4, 3), textcoords="offset points", fontsize=8)
    left.legend(frameon=False, fontsize=8)
    stream = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "semlive", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", facecolor="white", metadata={"Date": None})
    return re.sub(r"[ \t]+$", "", stream.getvalue(), flags=re.MULTILINE)


def _curve(axes: Axes, figures: RunFigures, names: tuple[str, ...]) -> None:
    curve = next(iter(figures.phases.values())).curve
    length = [row.vsg_px for row in curve]
    points = [pooled(figures, at, names) for at in range(len(curve))]
    axes.loglog(length, [item.predicted for item in points], color=_INK, linewidth=1.0, label="predicted from DIC noise alone")
    axes.loglog(length, [item.measured for item in points], "o", color=_BLUE, markersize=3.5, label="measured")
    axes.loglog(length, [item.correction for item in points], ".--", color=_ORANGE, linewidth=0.9, label="error of the correction alone")
    ticks = [50, 70, 100, 150, 200, 300, 500]
    axes.set_xticks(ticks, [str(item) for item in ticks])
    axes.minorticks_off()
    axes.set_xlabel("virtual strain gauge (px)")
    axes.grid(visible=True, color="#94a3b8", alpha=0.25, linewidth=0.6)
