"""Standard figures of a run: load, drift, distortion, fields of a frame, stress and strain, comparison with a strain gage."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.loading import LoadSeries
from semlive.data.pair import PairDecision
from semlive.data.results import FrameResult, RunResult
from semlive.data.strain import StrainGageComparison
from semlive.report.maps import ROUND_STEPS, ColourRange, ImageScale, colour_range, draw_map, label_lengths, map_sheet, masked
from semlive.report.style import INK, PAGE_INCH, X_COLOUR, Y_COLOUR, fix_layout, framed, plain_axes, png

__all__ = [
    "FieldSheet",
    "colour_bar",
    "distortion_fields",
    "drift_over_time",
    "field_maps",
    "gage_comparison",
    "load_over_time",
    "png",
    "stress_strain",
    "thinned",
]
Field = NDArray[np.float64]
MAX_SAMPLES = 4000
"""Largest number of samples of a curve in a figure: twice the dots of a printed page."""
MICRO = 1e6


def load_over_time(series: LoadSeries, result: RunResult) -> Figure:
    """Load against time, the scans of accepted frames shaded."""
    figure, axes = framed(PAGE_INCH, 2.3)
    draw_load(axes, series, result)
    axes.set(xlabel="time since the start of frame 0 (min)")
    return figure


def draw_load(axes: Axes, series: LoadSeries, result: RunResult) -> None:
    """Draw load against time with the scans of accepted frames shaded."""
    zero_ns = zero_time_ns(result)
    at = thinned(series.force_n)
    axes.plot((series.time_ns[at] - zero_ns) / 60e9, series.force_n[at], color=INK, linewidth=1.0)
    shade_scans(axes, result.decisions, zero_ns)
    axes.set(ylabel="load (N)")


def shade_scans(axes: Axes, decisions: tuple[PairDecision, ...], zero_ns: int) -> None:
    """Shade the scans of all pairs."""
    for decision in decisions:
        for info in (decision.first, decision.second):
            start, end = ((t - zero_ns) / 60e9 for t in (info.start_time_ns.value, info.end_time_ns))
            axes.axvspan(start, end, color=X_COLOUR, alpha=0.18, linewidth=0)


def thinned(values: Field) -> NDArray[np.intp]:
    """Indices of at most `MAX_SAMPLES` samples that keep the smallest and the largest of every block."""
    if values.size <= MAX_SAMPLES:
        return np.arange(values.size)
    blocks = np.array_split(np.arange(values.size), MAX_SAMPLES // 2)
    extremes = [block[at] for block in blocks for at in sorted({int(np.argmin(values[block])), int(np.argmax(values[block]))})]
    return np.array(extremes)


def drift_over_time(result: RunResult) -> Figure:
    """Drift against scan time with its band of two standard uncertainties."""
    figure, axes = framed(PAGE_INCH, 2.5)
    drift = result.estimate.drift
    minutes = drift.time_s / 60
    for axis, (name, colour) in enumerate((("x", X_COLOUR), ("y", Y_COLOUR))):
        value, sigma = drift.drift_px[:, axis], drift.sigma_px[:, axis]
        axes.plot(minutes, value, ".-", color=colour, linewidth=0.9, markersize=2.5, label=f"drift along {name}")
        axes.fill_between(minutes, value - 2 * sigma, value + 2 * sigma, color=colour, alpha=0.25, linewidth=0)
    axes.set(xlabel="scan time since the start of frame 0 (min)", ylabel="drift (px)")
    axes.legend(frameon=False)
    return figure


def distortion_fields(result: RunResult, scale: ImageScale | None = None) -> Figure:
    """Both components of the distortion at the scan address, on one colour range.

    Args:
        result: of the run.
        scale: unit of lengths; None for px.
    """
    field, scale = result.estimate.distortion, scale or ImageScale()
    grid = field.grid
    figure, panels = map_sheet(1, 2, (grid.ny + 1) / (grid.nx + 1), PAGE_INCH)
    colours = colour_range([field.ex_px[field.valid], field.ey_px[field.valid]])
    for axes, values, name in zip(panels[0], (field.ex_px, field.ey_px), ("x", "y"), strict=True):
        draw_map(axes, grid, values, field.valid, colours, scale)
        axes.set_title(f"along {name}")
    label_lengths(panels, scale)
    colour_bar(figure, panels[0], colours, "distortion (px)")
    return figure


class FieldSheet:
    """Displacement and strain of a frame as maps with colour bars, px; unmeasured points are blank.

    The figure is made and laid out for the first frame and then only gets new values: of 1.3 s for a frame 1.1 s were layout and labels.
    """

    def __init__(self) -> None:
        self._figure = Figure(figsize=(12.0, 6.4), layout="constrained")
        self._title = self._figure.suptitle("", fontsize=10)
        self._images: list[AxesImage] = []

    def draw(self, frame: FrameResult, title: str) -> Figure:
        """Return the figure with the values of a frame; it changes with the next call.

        Args:
            frame: on the same grid at every call.
            title: of the sheet.
        """
        fields = _sheet_fields(frame)
        if self._images:
            for image, (values, valid, _) in zip(self._images, fields, strict=True):
                colours = colour_range([values[valid]])
                image.set_data(masked(values, valid))
                image.set(cmap=colours.colours, clim=(colours.low, colours.high))
        else:
            self._make(frame.displacement.grid, fields, title)
        self._title.set_text(title)
        return self._figure

    def _make(self, grid: Grid, fields: list[tuple[Field, NDArray[np.bool_], str]], title: str) -> None:
        scale = ImageScale()
        for axes, (values, valid, name) in zip(self._figure.subplots(2, 3).flat, fields, strict=True):
            image = draw_map(axes, grid, values, valid, colour_range([values[valid]]), scale)
            self._figure.colorbar(image, ax=axes, shrink=0.85, label=name, pad=0.03)
            axes.set(xlabel="x (px)", ylabel="y (px)")
            self._images.append(image)
        self._title.set_text(title)
        fix_layout(self._figure)


def field_maps(frame: FrameResult, title: str) -> Figure:
    """Displacement and strain of one frame, each with its colour bar; unmeasured points are blank."""
    return FieldSheet().draw(frame, title)


def _sheet_fields(frame: FrameResult) -> list[tuple[Field, NDArray[np.bool_], str]]:
    """The fields of a sheet: values, where they were measured, and label with unit."""
    moved, strain = frame.displacement, frame.strain
    fields = [(moved.u_px, moved.valid, "u (px)"), (moved.v_px, moved.valid, "v (px)"), (moved.sigma_u_px, moved.valid, "sigma u (px)")]
    fields += [(MICRO * getattr(strain, name), strain.valid, f"{name} (10⁻⁶)") for name in ("exx", "eyy", "exy")]
    return fields


def stress_strain(result: RunResult, area_mm2: float, loading_axis: str) -> Figure | None:
    """Stress against axial and transverse mean strain, with the fitted lines and their bands; None without loads.

    Bars and bands are two standard uncertainties; the band of a line is that of its slope about the mean of the points.
    """
    points = _stress_points(result, area_mm2, loading_axis)
    if points.size == 0 or result.elastic is None:
        return None
    figure, axes = framed(0.75 * PAGE_INCH, 3.1)
    stress, stress_sd, axial, axial_sigma, transverse, transverse_sigma = points.T
    modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
    span = np.linspace(axial.min(), axial.max(), 50)
    line = stress.mean() + modulus.value * 1e3 * (span - axial.mean())
    drawn = (
        ("axial", "o", Y_COLOUR, axial, axial_sigma, axial.mean(), 1.0, modulus.sigma / modulus.value),
        ("transverse", "s", X_COLOUR, transverse, transverse_sigma, transverse.mean(), -ratio.value, ratio.sigma / abs(ratio.value)),
    )
    for name, marker, colour, strain, sigma, middle, slope, relative in drawn:
        axes.errorbar(1e3 * strain, stress, 2 * stress_sd, 2e3 * sigma, fmt=marker, color=colour, linewidth=0.9, label=name)
        along = slope * (span - axial.mean())
        axes.plot(1e3 * (middle + along), line, color=colour, linewidth=0.9)
        edges = [1e3 * (middle + along * (1 + sign * 2 * relative)) for sign in (-1, 1)]
        axes.fill_betweenx(line, *edges, color=colour, alpha=0.25, linewidth=0)
    axes.set(xlabel="mean strain (10⁻³)", ylabel="stress (MPa)")
    axes.legend(frameon=False, loc="best")
    return figure


def gage_comparison(gage: StrainGageComparison) -> Figure:
    """Axial strain of DIC over that of the gage at every load step, and the residual of the fitted line (Fig. 14)."""
    figure = Figure(figsize=(PAGE_INCH, 2.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    plain_axes(left, right)
    by_gage, by_dic, sigma = (np.array([getattr(step, name) for step in gage.steps]) for name in ("gage_strain", "dic_strain", "dic_sigma"))
    slope = gage.dic_over_gage.value
    weight = sigma**-2.0
    line = np.average(by_dic, weights=weight) + slope * (by_gage - np.average(by_gage, weights=weight))
    left.errorbar(by_gage * 1e3, by_dic * 1e3, 2e3 * sigma, fmt="o", color=Y_COLOUR, linewidth=0.9)
    left.plot(by_gage * 1e3, line * 1e3, color=Y_COLOUR, linewidth=0.9)
    left.set(xlabel="strain of the gage (10⁻³)", ylabel="axial mean strain by DIC (10⁻³)")
    right.errorbar(by_gage * 1e3, (by_dic - line) * MICRO, 2 * sigma * MICRO, fmt="o", color=Y_COLOUR, linewidth=0.9)
    right.axhline(0.0, color=INK, linewidth=0.6)
    right.set(xlabel="strain of the gage (10⁻³)", ylabel="DIC minus the line (10⁻⁶)")
    return figure


def colour_bar(figure: Figure, panels: list[Axes], colours: ColourRange, label: str) -> None:
    """Draw one colour bar for a row of maps; it has triangles at its ends, because the outermost percents exceed the range."""
    source = ScalarMappable(Normalize(colours.low, colours.high), colours.colours)
    figure.colorbar(
        source, ax=panels, label=label, extend="both", shrink=0.92, pad=0.015, aspect=16, ticks=MaxNLocator(5, steps=ROUND_STEPS)
    )


def _stress_points(result: RunResult, area_mm2: float, loading_axis: str) -> Field:
    """(n, 6) stress in MPa, axial and transverse mean strain of every tension frame, each followed by its standard uncertainty."""
    frames = {summary.frame: summary for summary in result.summaries}
    rows = []
    for decision in result.decisions:
        if decision.step.phase is Phase.TENSION and decision.loads:
            for member in (0, 1):
                summary, load = frames[2 * decision.pair + member], decision.loads[member]
                axial, transverse = ("eyy", "exx") if loading_axis == "y" else ("exx", "eyy")
                strains = [getattr(part, name) for name in (axial, transverse) for part in (summary.mean, summary.mean_sigma)]
                rows.append((load.mean_n / area_mm2, load.sd_n / area_mm2, *strains))
    return np.array(rows).reshape(-1, 6)


def zero_time_ns(result: RunResult) -> int:
    """Start of frame 0, UTC ns."""
    return result.decisions[0].first.start_time_ns.value
