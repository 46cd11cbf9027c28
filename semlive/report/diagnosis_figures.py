"""Figures of a diagnosis: maps before and after, time courses of effects, spectrum of rows, and residual quantiles."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from semlive.data.diagnosis.channels import IntensityDiagnosis, RowDiagnosis
from semlive.data.diagnosis.verdict import DiagnosisFigureData, EffectProfile
from semlive.report.figures import GRID, INK, X_COLOUR, Y_COLOUR, framed


def residual_maps(pictures: DiagnosisFigureData) -> Figure:
    """Residual of frames without and with the effects, on one scale, in standard deviations of the noise."""
    count = len(pictures.frame)
    figure = Figure(figsize=(2.7 * count + 0.8, 8.4), layout="constrained")
    grid = figure.subplots(4, count, squeeze=False)
    limit = max(3.0, float(np.quantile(np.abs(pictures.before), 0.99)))
    rows = [(state, axis) for axis in (0, 1) for state in ("before", "after")]
    drawn = None
    for at, (state, axis) in enumerate(rows):
        values = getattr(pictures, state)[..., axis]
        for column in range(count):
            axes = grid[at, column]
            drawn = _dots(axes, pictures, values[column], limit)
            if column == 0:
                axes.set_ylabel(f"{'xy'[axis]}, {state}", fontsize=9)
            if at == 0:
                axes.set_title(f"frame {pictures.frame[column]}", fontsize=9)
    if drawn is not None:
        figure.colorbar(drawn, ax=grid, label="standard deviations of the noise", shrink=0.6)
    return figure


def _dots(axes: Axes, pictures: DiagnosisFigureData, values: np.ndarray, limit: float) -> PathCollection:
    size = 1.1e4 / max(len(values), 1)
    drawn = axes.scatter(pictures.x_px, pictures.y_px, c=values, s=size, marker="s", cmap="RdBu_r", vmin=-limit, vmax=limit, linewidths=0)
    axes.invert_yaxis()
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    return drawn


def effect_profile(profile: EffectProfile) -> Figure:
    """Amplitude of an effect in each frame, measured and by the model."""
    figure, axes = framed(9.0, 3.0)
    order = np.argsort(profile.at, kind="stable")
    at = profile.at[order] / (60.0 if profile.abscissa == "time" else 1.0)
    axes.errorbar(
        at, profile.data_px[order], 2.0 * profile.sigma_px[order], fmt=".", color=X_COLOUR, elinewidth=0.8, label="maps, two sigma"
    )
    axes.plot(at, profile.model_px[order], "-", color=Y_COLOUR, linewidth=1.0, label="model")
    over = "start of the frame since frame 0 (min)" if profile.abscissa == "time" else "load (N)"
    axes.set(xlabel=over, ylabel="amplitude (px at the peak of the shape)")
    axes.legend(frameon=False)
    return figure


def row_spectrum(rows: RowDiagnosis) -> Figure:
    """Power of waves in the rows over their frequency."""
    figure, axes = framed(9.0, 3.0)
    axes.semilogy(rows.frequency_hz, rows.power, color=X_COLOUR, linewidth=0.7)
    axes.axhline(rows.detection_threshold, color=Y_COLOUR, linewidth=0.9, linestyle="--", label="exceeded by 1 % of noise spectra")
    axes.set(xlabel="frequency (Hz)", ylabel="power, in units of noise")
    axes.legend(frameon=False)
    return figure


def intensity_history(grey: IntensityDiagnosis) -> Figure:
    """Mean, gain, curvature and blur of every frame relative to the first pair, with the fitted intensity models."""
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    minutes = np.array(grey.time_s) / 60.0
    for at, course in enumerate(grey.histories):
        axes = figure.add_subplot(2, 2, at + 1)
        axes.errorbar(minutes, course.value, 2.0 * course.sigma, fmt=".", color=X_COLOUR, elinewidth=0.8, label="frames, two sigma")
        axes.plot(minutes, course.fitted, "-", color=Y_COLOUR, linewidth=1.0, label="models")
        unit = "" if course.unit == "1" else f" ({course.unit.replace('^2', '²')})"
        axes.set(xlabel="time since frame 0 (min)", ylabel=f"{course.name}{unit}")
        axes.grid(**GRID)
        if at == 0:
            axes.legend(frameon=False)
    return figure


def residual_quantiles(pictures: DiagnosisFigureData) -> Figure:
    """Quantiles of the whitened residual against those of a normal distribution."""
    figure, axes = framed(4.6, 3.6)
    normal, values = pictures.quantiles.T
    axes.plot(normal, normal, color=INK, linewidth=0.7)
    axes.plot(normal, values, ".", color=X_COLOUR, markersize=3.5)
    axes.set(xlabel="normal distribution", ylabel="whitened residual")
    axes.grid(**GRID)
    return figure
