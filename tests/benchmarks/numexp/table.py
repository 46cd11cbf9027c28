"""The table: which figure of which case, over the seeds, against the paper and the bar."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numexp.cases import magnification_growth
from numexp.measure import Measured
from numexp.world import SCAN, Field, start_s

Results = dict[tuple[str, str], list[Measured]]
"""(case, method) -> one for each seed."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure over the seeds.

    Attributes:
        value: 95th percentile of the seeds, or for a bias the largest mean over seeds.
        spread: median of the seeds, or for a bias the standard error of that mean.
    """

    value: float
    spread: float


@dataclass(frozen=True, slots=True)
class Row:
    """One row.

    Attributes:
        name: the measured quantity.
        case: name of the case.
        figure: from the seeds of one method.
        bias: whether `figure` is a mean over seeds with its standard error, else a percentile with the median.
        paper: the paper's figure, as text.
        bar: not to be exceeded by the joint method; None where nothing is required.
        scale: in which the row is printed.
        unit: its name.
    """

    name: str
    case: str
    figure: Callable[[Sequence[Measured]], Figure]
    bias: bool
    paper: str
    bar: float | None
    scale: float
    unit: str


def percentile(value: Callable[[Measured], float]) -> Callable[[Sequence[Measured]], Figure]:
    """95th percentile and median over the seeds."""

    def figure(seeds: Sequence[Measured]) -> Figure:
        values = [value(one) for one in seeds]
        return Figure(float(np.percentile(values, 95)), float(np.median(values)))

    return figure


def bias(value: Callable[[Measured], Field]) -> Callable[[Sequence[Measured]], Figure]:
    """The largest mean over seeds of any entry of an array, with its standard error."""

    def figure(seeds: Sequence[Measured]) -> Figure:
        values = np.array([value(one) for one in seeds]).reshape(len(seeds), -1)
        mean = np.abs(values.mean(axis=0))
        worst = int(np.argmax(mean))
        error = float(values[:, worst].std(ddof=1) / np.sqrt(len(seeds))) if len(seeds) > 1 else float("nan")
        return Figure(float(mean[worst]), error)

    return figure


def _largest(array: Field) -> float:
    return float(np.abs(array).max())


def _sd(one: Measured) -> float:
    return float(np.sqrt(np.mean(one.correction_sd**2, axis=0)).max())


def _magnification(one: Measured) -> float:
    middle_s = 0.5 * SCAN.frame_time_s
    true = magnification_growth(middle_s, start_s(29) + middle_s)
    return abs(one.magnification / true - 1.0) if one.magnification is not None else float("nan")


_distortion = percentile(lambda one: one.distortion_max_px)
_noisy = percentile(lambda one: _largest(one.mean_strain))
_alone = percentile(lambda one: _largest(one.correction_mean_strain))
_field_sd = percentile(_sd)
_displacement = percentile(lambda one: one.displacement_rms_px)
_strain_bias = bias(lambda one: one.correction_mean_strain)
_load_bias = bias(lambda one: one.load_step_strain)
_field_worst = percentile(lambda one: _largest(one.correction_sd))

ROWS = (
    Row("false strain anywhere, 9 x 9 points", "smooth", percentile(lambda one: one.correction_max), False, "1000", None, 1e-6, "1e-6"),
    Row("residual distortion, max", "smooth", _distortion, False, "0.02", 0.006, 1.0, "px"),
    Row("mean strain of the noisy points, any frame", "smooth", _noisy, False, "60", 8e-6, 1e-6, "1e-6"),
    Row("the same, correction alone", "smooth", _alone, False, "-", 2e-6, 1e-6, "1e-6"),
    Row("strain error of the correction, sd", "smooth", _field_sd, False, "50", 1e-5, 1e-6, "1e-6"),
    Row("the same in the worst frame", "smooth", _field_worst, False, "-", None, 1e-6, "1e-6"),
    Row("residual distortion, equation 9, 0.025 px in each position", "paper", _distortion, False, "0.02", None, 1.0, "px"),
    Row("mean strain of the noisy points, equation 9", "paper", _noisy, False, "60", None, 1e-6, "1e-6"),
    Row("strain error of the correction, sd, equation 9", "paper", _field_sd, False, "50", None, 1e-6, "1e-6"),
    Row("correlated noise: residual distortion, max", "correlated", _distortion, False, "-", 0.03, 1.0, "px"),
    Row("correlated noise: strain error, sd", "correlated", _field_sd, False, "-", 4e-5, 1e-6, "1e-6"),
    Row("correlated noise: mean strain of the noisy points", "correlated", _noisy, False, "-", None, 1e-6, "1e-6"),
    Row("no noise: strain, max", "exact", percentile(lambda one: one.correction_max), False, "1", 1e-6, 1e-6, "1e-6"),
    Row("no noise: mean strain, any frame", "exact", _alone, False, "1", 1e-7, 1e-6, "1e-6"),
    Row("no noise, equation 9: strain, max", "paper_exact", percentile(lambda one: one.correction_max), False, "1", None, 1e-6, "1e-6"),
    Row("wandering drift: displacement error, rms", "wander", _displacement, False, "-", 0.006, 1.0, "px"),
    Row("magnification drift 5e-4: strain bias", "magnification", _strain_bias, True, "-", 1.5e-5, 1e-6, "1e-6"),
    Row("magnification drift 5e-4: recovered within", "magnification", percentile(_magnification), False, "-", 0.03, 0.01, "%"),
    Row("tension: bias of a load step's mean strain", "tension", _load_bias, True, "-", 1e-5, 1e-6, "1e-6"),
)  # fmt: skip


def table(results: Results, methods: Sequence[str], rows: Sequence[Row] = ROWS) -> list[str]:
    """Markdown lines."""
    head = ["figure", "unit", "paper", "bar", *methods, "bar held"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        if not any((row.case, method) in results for method in methods):
            continue
        bar = "-" if row.bar is None else f"{row.bar / row.scale:.3g}"
        cells = [row.name, row.unit, row.paper, bar]
        for method in methods:
            cells.append(_cell(row, results.get((row.case, method), [])))
        held = "-"
        if row.bar is not None and results.get((row.case, "joint")):
            held = "yes" if row.figure(results[row.case, "joint"]).value <= row.bar else "no"
        lines.append("| " + " | ".join([*cells, held]) + " |")
    return lines


def _cell(row: Row, seeds: Sequence[Measured]) -> str:
    if not seeds:
        return "-"
    figure = row.figure(seeds)
    if np.isnan(figure.value):
        return "-"
    value, spread = figure.value / row.scale, figure.spread / row.scale
    return f"{value:.3g} ± {spread:.2g}" if row.bias else f"{value:.3g} ({spread:.3g})"
