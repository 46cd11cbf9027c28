"""Figures of a diagnosis: maps before and after, time courses of effects, spectrum of rows, quantiles, and bars of evidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from semlive.data.diagnosis.channels import IntensityDiagnosis, RowDiagnosis
from semlive.data.diagnosis.verdict import DiagnosisFigureData, EffectProfile
from semlive.report.maps import ImageScale
from semlive.report.paper_figures import spread
from semlive.report.style import INK, PAGE_INCH, SOFT, X_COLOUR, Y_COLOUR, framed, plain_axes

MAX_RESIDUAL_MAPS = 5
"""Largest number of frames whose residual is drawn."""


def residual_maps(pictures: DiagnosisFigureData, scale: ImageScale) -> Figure:
    """Residual of frames without and with the effects, on one scale, in standard deviations of the noise.

    Args:
        pictures: data of the figures; at most `MAX_RESIDUAL_MAPS` frames are drawn, evenly spread.
        scale: unit of lengths.
    """
    shown = spread(range(len(pictures.frame)), MAX_RESIDUAL_MAPS)
    aspect = float(np.ptp(pictures.y_px) / max(np.ptp(pictures.x_px), 1.0)) or 1.0
    panel = (PAGE_INCH - 1.2) / max(len(shown), 2)
    figure = Figure(figsize=(PAGE_INCH, 4 * (panel * aspect + 0.12) + 0.7), layout="constrained")
    grid = figure.subplots(4, len(shown), squeeze=False, sharex=True, sharey=True)
    limit = max(3.0, float(np.quantile(np.abs(pictures.before), 0.99)))
    drawn = None
    for row, (state, axis) in zip(grid, [(state, axis) for axis in (0, 1) for state in ("before", "after")], strict=True):
        for axes, at in zip(row, shown, strict=True):
            drawn = _dots(axes, pictures, getattr(pictures, state)[at, :, axis], limit, scale, panel)
        row[0].set_ylabel(f"along {'xy'[axis]}, {state}\ny ({scale.unit})")
    for axes, at in zip(grid[0], shown, strict=True):
        axes.set_title(f"frame {pictures.frame[at]}")
    for axes in grid[-1]:
        axes.set_xlabel(f"x ({scale.unit})")
        axes.locator_params(nbins=3)
    grid[0, 0].invert_yaxis()
    if drawn is not None:
        figure.colorbar(drawn, ax=grid, label="residual (standard deviations of the noise)", shrink=0.6, aspect=40, extend="both")
    return figure


def _dots(
    axes: Axes, pictures: DiagnosisFigureData, values: np.ndarray, limit: float, scale: ImageScale, panel_inch: float
) -> PathCollection:
    # Squares that touch: the area of a panel in points squared over the number of blocks.
    size = 0.8 * (72.0 * panel_inch) ** 2 / max(len(values), 1)
    x, y = scale.factor * pictures.x_px, scale.factor * pictures.y_px
    drawn = axes.scatter(x, y, c=values, s=size, marker="s", cmap="RdBu_r", vmin=-limit, vmax=limit, linewidths=0, rasterized=True)
    axes.set_aspect("equal")
    return drawn


def bars(rows: Sequence[tuple[str, float, str]], label: str, mark: float | None = None) -> Figure:
    """Horizontal bars with their values as text.

    Args:
        rows: name, length and text of each bar, from top to bottom.
        label: label of the abscissa.
        mark: a threshold, drawn as a dashed line; shorter bars are pale.
    """
    figure, axes = framed(PAGE_INCH, 0.55 + 0.22 * len(rows))
    lengths = [length for _, length, _ in rows]
    colours = [X_COLOUR if mark is None or length >= mark else SOFT for length in lengths]
    axes.barh(range(len(rows)), lengths, color=colours, height=0.6)
    for at, (_, length, text) in enumerate(rows):
        axes.annotate(text, (length, at), xytext=(3, 0), textcoords="offset points", va="center", fontsize=7)
    if mark is not None:
        axes.axvline(mark, color=Y_COLOUR, linewidth=0.9, linestyle="--")
    axes.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    axes.invert_yaxis()
    axes.set(xlabel=label, xlim=(0.0, 1.15 * max([*lengths, mark or 0.0, 1e-12])))
    return figure


def misfit_bars(before_px: float, after_px: float, floor_px: float) -> Figure:
    """Root mean square residuals without the effects, with them, and by noise alone, px."""
    sizes = (("without the effects", before_px), ("with the effects", after_px), ("noise alone", floor_px))
    return bars([(label, size, f"{size:.4f} px") for label, size in sizes], "root mean square residual (px)")


def effect_profile(profile: EffectProfile) -> Figure:
    """Amplitude of an effect in each frame, measured and by the model."""
    figure, axes = framed(PAGE_INCH, 2.3)
    order = np.argsort(profile.at, kind="stable")
    at = profile.at[order] / (60.0 if profile.abscissa == "time" else 1.0)
    axes.errorbar(
        at,
        profile.data_px[order],
        2.0 * profile.sigma_px[order],
        fmt=".",
        color=X_COLOUR,
        elinewidth=0.8,
        label="maps, two standard uncertainties",
    )
    axes.plot(at, profile.model_px[order], "-", color=Y_COLOUR, linewidth=1.0, label="model")
    over = "start of the frame since frame 0 (min)" if profile.abscissa == "time" else "load (N)"
    axes.set(xlabel=over, ylabel="amplitude (px)")
    axes.legend(frameon=False)
    return figure


def row_spectrum(rows: RowDiagnosis) -> Figure:
    """Power of waves in the rows over their frequency."""
    figure, axes = framed(PAGE_INCH, 2.3)
    axes.semilogy(rows.frequency_hz, rows.power, color=X_COLOUR, linewidth=0.7)
    axes.axhline(rows.detection_threshold, color=Y_COLOUR, linewidth=0.9, linestyle="--", label="exceeded by 1 % of noise spectra")
    axes.set(xlabel="frequency (Hz)", ylabel="power (units of the noise)")
    axes.legend(frameon=False)
    return figure


def intensity_history(grey: IntensityDiagnosis) -> Figure:
    """Mean, gain, curvature and blur of every frame relative to the first pair, with the fitted intensity models."""
    figure = Figure(figsize=(PAGE_INCH, 4.6), layout="constrained")
    minutes = np.array(grey.time_s) / 60.0
    for at, course in enumerate(grey.histories):
        axes = figure.add_subplot(2, 2, at + 1)
        axes.errorbar(
            minutes, course.value, 2.0 * course.sigma, fmt=".", color=X_COLOUR, elinewidth=0.8, label="frames, two standard uncertainties"
        )
        axes.plot(minutes, course.fitted, "-", color=Y_COLOUR, linewidth=1.0, label="models")
        unit = "" if course.unit == "1" else f" ({course.unit.replace('^2', '²')})"
        axes.set(xlabel="time since frame 0 (min)", ylabel=f"{course.name}{unit}")
        plain_axes(axes)
        if at == 0:
            axes.legend(frameon=False)
    return figure


def residual_quantiles(pictures: DiagnosisFigureData) -> Figure:
    """Quantiles of the whitened residual against those of a normal distribution."""
    figure, axes = framed(0.5 * PAGE_INCH, 2.8)
    normal, values = pictures.quantiles.T
    axes.plot(normal, normal, color=INK, linewidth=0.7)
    axes.plot(normal, values, ".", color=X_COLOUR, markersize=3.5)
    axes.set(xlabel="quantile of a normal distribution", ylabel="quantile of the whitened residual")
    return figure
