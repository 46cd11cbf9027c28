"""Figures of a run, as PNG for the page."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from semlive.data.experiment import Phase
from semlive.data.loading import LoadSeries
from semlive.data.pair import PairDecision
from semlive.data.results import FrameResult, RunResult
from semlive.data.strain import StrainGageComparison

X_COLOUR, Y_COLOUR, INK = "#2563eb", "#d97706", "#0f172a"
GRID: dict[str, Any] = {"color": "#94a3b8", "alpha": 0.25, "linewidth": 0.6}


def png(figure: Figure) -> bytes:
    """The figure as PNG bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=130, facecolor="white")
    return stream.getvalue()


def load_over_time(series: LoadSeries, result: RunResult) -> Figure:
    """Load against time, the scans of accepted frames marked."""
    figure, axes = framed(9.0, 3.0)
    zero_ns = _zero_ns(result)
    axes.plot((series.time_ns - zero_ns) / 60e9, series.force_n, color=INK, linewidth=1.0)
    for decision in result.decisions:
        for info in (decision.first, decision.second):
            start, end = ((t - zero_ns) / 60e9 for t in (info.start_time_ns.value, info.end_time_ns))
            axes.axvspan(start, end, color=X_COLOUR, alpha=0.14, linewidth=0)
    axes.set(xlabel="time since frame 0 (min); shaded: accepted frames", ylabel="load (N)")
    return figure


def drift_over_time(result: RunResult) -> Figure:
    """Drift against scan time with its band of two standard uncertainties."""
    figure, axes = framed(9.0, 3.4)
    drift = result.estimate.drift
    minutes = drift.time_s / 60
    for axis, (name, colour) in enumerate((("x", X_COLOUR), ("y", Y_COLOUR))):
        value, sigma = drift.drift_px[:, axis], drift.sigma_px[:, axis]
        axes.plot(minutes, value, ".-", color=colour, linewidth=0.9, markersize=2.5, label=f"drift {name}")
        axes.fill_between(minutes, value - 2 * sigma, value + 2 * sigma, color=colour, alpha=0.25, linewidth=0)
    axes.set(xlabel="scan time since frame 0 (min)", ylabel="drift (px)")
    axes.legend(frameon=False)
    return figure


def distortion_fields(result: RunResult) -> Figure:
    """Both components of the distortion at the scan address."""
    field = result.estimate.distortion
    grid = field.grid
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for axes, values, name in zip(figure.subplots(1, 2), (field.ex_px, field.ey_px), ("x", "y"), strict=True):
        draw_map(figure, axes, grid.x_px, grid.y_px, values, field.valid, f"distortion {name} (px)", robust=False)
    return figure


def strain_maps(frame: FrameResult, title: str) -> Figure:
    """The three components of one frame's strain."""
    figure = Figure(figsize=(11.0, 3.2), layout="constrained")
    field = frame.strain
    components = ((field.exx, "exx"), (field.eyy, "eyy"), (field.exy, "exy"))
    for axes, (values, name) in zip(figure.subplots(1, 3), components, strict=True):
        draw_map(figure, axes, field.grid.x_px, field.grid.y_px, values, field.valid, name, robust=True)
    figure.suptitle(title, fontsize=10)
    return figure


def field_maps(frame: FrameResult, title: str) -> Figure:
    """Displacement and strain of one frame, each with its colour bar; unmeasured points are blank."""
    figure = Figure(figsize=(12.0, 6.4), layout="constrained")
    moved, strain = frame.displacement, frame.strain
    grid = moved.grid
    fields = [(moved.u_px, moved.valid, "u (px)"), (moved.v_px, moved.valid, "v (px)"), (moved.sigma_u_px, moved.valid, "sigma u (px)")]
    fields += [(getattr(strain, name), strain.valid, name) for name in ("exx", "eyy", "exy")]
    for axes, (values, valid, name) in zip(figure.subplots(2, 3).flat, fields, strict=True):
        draw_map(figure, axes, grid.x_px, grid.y_px, values, valid, name, robust=True)
    figure.suptitle(title, fontsize=10)
    return figure


def stress_strain(result: RunResult, area_mm2: float, loading_axis: str) -> Figure | None:
    """Stress against axial and transverse mean strain, with the fitted lines; None without loads."""
    points = _stress_points(result, area_mm2, loading_axis)
    if points.size == 0 or result.elastic is None:
        return None
    figure, axes = framed(7.0, 4.2)
    stress, axial, transverse = points.T
    modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
    axes.plot(axial * 1e3, stress, "o", color=Y_COLOUR, label="axial")
    axes.plot(transverse * 1e3, stress, "s", color=X_COLOUR, label="transverse")
    span = np.array([axial.min(), axial.max()])
    line = stress.mean() + modulus.value * 1e3 * (span - axial.mean())
    axes.plot(span * 1e3, line, color=Y_COLOUR, linewidth=0.9)
    axes.plot((transverse.mean() - ratio.value * (span - axial.mean())) * 1e3, line, color=X_COLOUR, linewidth=0.9)
    axes.set(xlabel="mean strain (1e-3)", ylabel="stress (MPa)")
    axes.set_title(
        f"E = {modulus.value:.2f} ± {modulus.sigma:.2f} GPa, Poisson's ratio = {ratio.value:.4f} ± {ratio.sigma:.4f}", fontsize=10
    )
    axes.legend(frameon=False)
    return figure


def gage_comparison(gage: StrainGageComparison) -> Figure:
    """Axial strain of DIC over that of the gage at every load step, and the residual of the fitted line (Fig. 14)."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    by_gage, by_dic, sigma = (np.array([getattr(step, name) for step in gage.steps]) for name in ("gage_strain", "dic_strain", "dic_sigma"))
    slope = gage.dic_over_gage.value
    weight = sigma**-2.0
    line = np.average(by_dic, weights=weight) + slope * (by_gage - np.average(by_gage, weights=weight))
    left.plot(by_gage * 1e3, by_dic * 1e3, "o", color=Y_COLOUR)
    left.plot(by_gage * 1e3, line * 1e3, color=Y_COLOUR, linewidth=0.9)
    left.set(xlabel="strain gage (1e-3)", ylabel="DIC, axial mean (1e-3)")
    left.set_title(f"slope = {slope:.4f} ± {gage.dic_over_gage.sigma:.4f}", fontsize=10)
    right.errorbar(by_gage * 1e3, (by_dic - line) * 1e6, sigma * 1e6, fmt="o", color=Y_COLOUR, linewidth=0.9)
    right.axhline(0.0, color=INK, linewidth=0.6)
    right.set(xlabel="strain gage (1e-3)", ylabel="DIC minus the line (1e-6)")
    for axes in (left, right):
        axes.grid(**GRID)
    return figure


def _stress_points(result: RunResult, area_mm2: float, loading_axis: str) -> NDArray[np.float64]:
    """(n, 3) stress in MPa, axial and transverse mean strain of every tension frame."""
    frames = {summary.frame: summary.mean for summary in result.summaries}
    rows = []
    for decision in result.decisions:
        if decision.step.phase is Phase.TENSION and decision.loads:
            for member in (0, 1):
                mean = frames[2 * decision.pair + member]
                axial, transverse = (mean.eyy, mean.exx) if loading_axis == "y" else (mean.exx, mean.eyy)
                rows.append((decision.loads[member].mean_n / area_mm2, axial, transverse))
    return np.array(rows).reshape(-1, 3)


def _zero_ns(result: RunResult) -> int:
    first: PairDecision = result.decisions[0]
    return first.first.start_time_ns.value


def framed(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure of the given size in inches with one pair of axes in the common style."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.grid(**GRID)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def draw_map(
    figure: Figure,
    axes: Axes,
    x_px: NDArray[np.float64],
    y_px: NDArray[np.float64],
    values: NDArray[np.float64],
    valid: NDArray[np.bool_],
    title: str,
    *,
    robust: bool,
) -> None:
    """A field over the image, y down, blank where it is not valid; `robust` excludes the outermost percents from the colour scale."""
    shown = np.ma.masked_array(values, ~valid)
    inside = values[valid]
    low, high = (0.0, 1.0) if inside.size == 0 else (np.percentile(inside, (1, 99)) if robust else (inside.min(), inside.max()))
    image = axes.imshow(shown, extent=(x_px[0], x_px[-1], y_px[-1], y_px[0]), cmap="viridis", vmin=low, vmax=high)
    axes.set_title(title, fontsize=9)
    axes.tick_params(labelsize=7)
    bar = figure.colorbar(image, ax=axes, shrink=0.85)
    bar.ax.tick_params(labelsize=7)
