"""Figures of a score: recovered and true values, and coverage of the stated uncertainties."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from numpy.typing import NDArray
from scipy.special import erf

from semlive.errors import BadInput
from semlive.report.scoring.errors import COMPONENTS, RunErrors

_COLOURS = ("#2563eb", "#d97706", "#0f766e", "#be123c")
SHEET_SUFFIXES = (".png", ".svg", ".pdf")
_POINTS = 200


def draw_drift(parent: FigureBase, errors: RunErrors) -> None:
    """Drift across each frame, recovered against true, and the error within frames with its band."""
    above, below = parent.subplots(2, 1, gridspec_kw={"height_ratios": (3, 2)})
    for axis, name in enumerate("xy"):
        true = [drift_error.true_px[-1, axis] - drift_error.true_px[0, axis] for drift_error in errors.drift]
        recovered = [drift_error.measured_px[-1, axis] - drift_error.measured_px[0, axis] for drift_error in errors.drift]
        above.plot(true, recovered, ".", color=_COLOURS[axis], label=name)
    _diagonal(above)
    above.set(xlabel="true drift across a frame (px)", ylabel="recovered (px)")
    above.legend(frameon=False)
    minutes = np.concatenate([drift_error.time_s for drift_error in errors.drift]) / 60
    for axis, name in enumerate("xy"):
        error = np.concatenate([drift_error.error_px[:, axis] for drift_error in errors.drift])
        below.plot(minutes, error * 1e3, ".", color=_COLOURS[axis], markersize=2, label=name)
    sigma = np.concatenate([drift_error.sigma_px.mean(axis=1) for drift_error in errors.drift]) * 1e3
    below.vlines(minutes, -2 * sigma, 2 * sigma, color="#94a3b8", alpha=0.3, linewidth=1.5)
    below.set(xlabel="scan time (min)", ylabel="error (1e-3 px)", title="within frames, grey: ± 2 sigma")


def draw_distortion(parent: FigureBase, errors: RunErrors) -> None:
    """Error of both components of the distortion, best affine map removed."""
    distortion = errors.distortion
    bound = float(np.abs(distortion.error_px).max()) or 1.0
    x, y = distortion.grid.x_px, distortion.grid.y_px
    for axis, (axes, name) in enumerate(zip(parent.subplots(2, 1), "xy", strict=True)):
        shown = np.ma.masked_where(~distortion.valid, distortion.error_px[..., axis] * 1e3)
        limit = 1e3 * bound
        drawn = axes.imshow(shown, extent=(x[0], x[-1], y[-1], y[0]), cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
        axes.set(title=f"error of distortion {name} (1e-3 px)", xlabel="x (px)", ylabel="y (px)")
        parent.colorbar(drawn, ax=axes)


def draw_strain(parent: FigureBase, errors: RunErrors) -> None:
    """Mean strain of every frame against truth, and its error."""
    above, below = parent.subplots(2, 1)
    frames = [frame.frame for frame in errors.frames]
    for c, name in enumerate(COMPONENTS):
        true, recovered, sigma = (
            np.array([part[c] for part in parts])
            for parts in zip(*((frame.true_strain, frame.mean_strain, frame.mean_sigma) for frame in errors.frames), strict=True)
        )
        above.plot(true * 1e3, recovered * 1e3, ".", color=_COLOURS[c], label=name)
        offset = 0.25 * (c - 1)
        error, bar = (recovered - true) * 1e6, sigma * 1e6
        below.errorbar(np.array(frames) + offset, error, bar, fmt=".", color=_COLOURS[c], linewidth=0.8)
    _diagonal(above)
    above.set(xlabel="true mean strain (1e-3)", ylabel="recovered (1e-3)")
    above.legend(frameon=False)
    below.axhline(0.0, color="#0f172a", linewidth=0.6)
    below.set(xlabel="frame", ylabel="error ± sigma (1e-6)")


def draw_coverage(parent: FigureBase, errors: RunErrors) -> None:
    """Fraction of errors within k stated standard uncertainties over that of a normal distribution."""
    axes: Axes = parent.subplots()
    k = np.linspace(0.0, 3.5, _POINTS)
    nominal = erf(k / np.sqrt(2))
    for (name, z), colour in zip(_normalised(errors).items(), _COLOURS, strict=False):
        if z.size:
            ordered = np.sort(np.abs(z).ravel())
            axes.plot(nominal, np.searchsorted(ordered, k, side="right") / z.size, color=colour, label=f"{name} ({z.size})")
    _diagonal(axes)
    axes.set(xlabel="stated probability", ylabel="fraction of errors inside", title="above the line: stated too wide, below: too narrow")
    axes.legend(frameon=False)


DRAWINGS: dict[str, Callable[[FigureBase, RunErrors], None]] = {
    "drift": draw_drift,
    "distortion": draw_distortion,
    "strain": draw_strain,
    "coverage": draw_coverage,
}


def save_figures(errors: RunErrors, where: Path) -> tuple[Path, ...]:
    """Write the figures.

    Args:
        errors: errors of a run.
        where: a .png, .svg or .pdf file for all of them on one sheet, otherwise a folder for one PNG each.

    Returns:
        Paths of the written files.

    Raises:
        BadInput: a file cannot be written.
    """
    try:
        if where.suffix.lower() in SHEET_SUFFIXES:
            where.parent.mkdir(parents=True, exist_ok=True)
            sheet = Figure(figsize=(12.0, 12.0), layout="constrained")
            for part, draw in zip(np.ravel(np.asarray(sheet.subfigures(2, 2))), DRAWINGS.values(), strict=True):
                draw(part, errors)
            sheet.savefig(where, dpi=110)
            return (where,)
        where.mkdir(parents=True, exist_ok=True)
        written = []
        for name, draw in DRAWINGS.items():
            figure = Figure(figsize=(7.0, 6.5), layout="constrained")
            draw(figure, errors)
            written.append(where / f"score-{name}.png")
            figure.savefig(written[-1], dpi=130)
        return tuple(written)
    except OSError as error:
        raise BadInput(f"{where}: {error.strerror}; give a folder, or a .png, .svg or .pdf file, that can be written") from error


def _normalised(errors: RunErrors) -> dict[str, NDArray[np.float64]]:
    distortion = errors.distortion
    strain = [(frame.mean_strain - frame.true_strain) / np.maximum(frame.mean_sigma, 1e-12) for frame in errors.frames]
    points = [frame.displacement_px[frame.valid] / np.maximum(frame.sigma_px[frame.valid], 1e-12) for frame in errors.frames]
    return {
        "drift within frames": np.concatenate([part.error_px / np.maximum(part.sigma_px, 1e-12) for part in errors.drift]),
        "distortion": distortion.error_px[distortion.valid] / np.maximum(distortion.sigma_px[distortion.valid], 1e-12)[:, None],
        "displacement of points": np.concatenate(points) if points else np.zeros(0),
        "mean strain of frames": np.array(strain),
    }


def _diagonal(axes: Axes) -> None:
    axes.axline((0.0, 0.0), slope=1.0, color="#94a3b8", linewidth=0.8, zorder=0)
    axes.grid(visible=True, color="#94a3b8", alpha=0.25, linewidth=0.6)
