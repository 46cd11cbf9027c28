"""The figures of Sutton et al. (2007), part II, for a run, with measured quantities in place of the simulated truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.experiment import Phase
from semlive.data.results import RunResult
from semlive.data.strain import Displacement, StrainSummary
from semlive.mechanics import false_strain
from semlive.report.figures import GRID, INK, X_COLOUR, Y_COLOUR, draw_map, framed

_SHEAR_COLOUR = "#059669"
_COMPONENTS = (("exx", X_COLOUR, "o"), ("eyy", Y_COLOUR, "s"), ("exy", _SHEAR_COLOUR, "^"))
SMOOTHED_POINTS = 21
"""Edge of the averaging window of Fig. 7: the noise of frame 0 (0.017 px per point in the simulated run) is common to all frames."""
TRANSLATED_PX = 5.0
"""Translation in Fig. 16."""
Field = NDArray[np.float64]


def drift_within_frames(result: RunResult) -> Figure:
    """Fig. 1: drift since the first row, frame by frame, over the time in the frame."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    drift, last = result.estimate.drift, max(int(result.estimate.drift.frame.max()), 1)
    for axes, axis in zip(_pair_of_axes(figure), (0, 1), strict=True):
        for number in np.unique(drift.frame):
            rows = drift.frame == number
            time_s = drift.time_s[rows] - drift.time_s[rows][0]
            shade = 0.15 + 0.75 * number / last
            axes.plot(time_s, drift.drift_px[rows, axis] - drift.drift_px[rows, axis][0], color=_shade(axis, shade), linewidth=0.9)
        axes.set(xlabel="time in the frame (s)", ylabel=f"drift {'xy'[axis]} since its first row (px)")
    figure.suptitle("one line a frame; the first are pale, the last dark", fontsize=9)
    return figure


def pair_residual(result: RunResult) -> Figure | None:
    """Fig. 6: residual between the two frames of the middle pair after correction; None without stored fields."""
    frames = {frame.summary.frame: frame.displacement for frame in result.frames}
    pairs = [decision.pair for decision in result.decisions if 2 * decision.pair in frames and 2 * decision.pair + 1 in frames]
    if not pairs:
        return None
    pair = pairs[len(pairs) // 2]
    first, second = frames[2 * pair], frames[2 * pair + 1]
    valid = first.valid & second.valid
    if not valid.any():
        return None
    figure = Figure(figsize=(11.0, 3.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    both = []
    for axes, name in ((left, "u"), (middle, "v")):
        off = getattr(second, f"{name}_px") - getattr(first, f"{name}_px")
        both.append(off[valid])
        draw_map(
            figure, axes, first.grid.x_px, first.grid.y_px, off, valid, f"{name}, frame {2 * pair + 1} less {2 * pair} (px)", robust=True
        )
    for values, colour in zip(both, (X_COLOUR, Y_COLOUR), strict=True):
        right.hist(values, bins=80, histtype="step", color=colour)
    labels = (f"{name}: sd {np.std(values):.4f}, mean {np.mean(values):+.4f}" for name, values in zip("uv", both, strict=True))
    right.set_title("\n".join(labels), fontsize=8)
    right.set(xlabel="residual (px); blue u, amber v", yticks=[])
    right.locator_params(axis="x", nbins=4)
    return figure


def distortion_residual(result: RunResult) -> Figure | None:
    """Fig. 7: mean residual of the unloaded frames after correction, without rigid motion and mean strain: uncorrected distortion."""
    phases = {decision.pair: decision.step.phase for decision in result.decisions}
    moved = [
        frame.displacement for frame in result.frames if phases[frame.summary.frame // 2] is not Phase.TENSION and frame.summary.frame > 1
    ]
    if len(moved) < 2:
        return None
    grid = moved[0].grid
    count = np.sum([field.valid for field in moved], axis=0)
    valid = count >= max(2, len(moved) // 2)
    if valid.sum() < 6:
        return None
    figure = Figure(figsize=(11.0, 3.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    sizes = []
    for axes, name in ((left, "u_px"), (middle, "v_px")):
        total = sum((_without_plane(field, name) for field in moved), np.zeros(grid.shape))
        common = _smoothed(total, count.astype(np.float64))
        sizes.append(float(np.sqrt(np.mean(common[valid] ** 2))))
        draw_map(figure, axes, grid.x_px, grid.y_px, common, valid, f"residual along {'x' if name[0] == 'u' else 'y'} (px)", robust=True)
    sigma = result.estimate.distortion
    draw_map(figure, right, sigma.grid.x_px, sigma.grid.y_px, sigma.sigma_px, sigma.valid, "stated sigma (px)", robust=False)
    over_px = SMOOTHED_POINTS * grid.step_px
    label = f"{len(moved)} frames, mean over {over_px} px: rms {sizes[0]:.4f} px along x, {sizes[1]:.4f} px along y"
    figure.suptitle(label, fontsize=9)
    return figure


def drift_over_field(result: RunResult) -> Figure:
    """Fig. 10: drift since the first row over the field of the middle frame."""
    drift = result.estimate.drift
    numbers = np.unique(drift.frame)
    number = int(numbers[len(numbers) // 2])
    rows = drift.frame == number
    decision = next(decision for decision in result.decisions if decision.pair == number // 2)
    info = decision.second if number % 2 else decision.first
    grid = result.estimate.distortion.grid
    x, y = grid.mesh()
    # The samples of the estimate have times in the frame; the mean scan time of integrated scans is later by a constant.
    time_s = info.timing.time_in_frame_s(x, y)
    in_frame_s = drift.time_s[rows] - drift.time_s[rows][0] + float(info.timing.time_in_frame_s(0.0, 0.0))
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    everywhere = np.ones(grid.shape, dtype=np.bool_)
    for axes, axis in zip(figure.subplots(1, 2), (0, 1), strict=True):
        values = np.interp(time_s, in_frame_s, drift.drift_px[rows, axis] - drift.drift_px[rows, axis][0])
        draw_map(figure, axes, grid.x_px, grid.y_px, values, everywhere, f"drift {'xy'[axis]} (px)", robust=False)
    figure.suptitle(f"frame {number}, {drift.time_s[rows][0] / 60:.0f} min after the run began", fontsize=9)
    return figure


def unloaded_strain(result: RunResult) -> Figure | None:
    """Fig. 12: mean and scatter of strain in the unloaded frames, where the true strain is zero."""
    phases = {decision.pair: decision.step.phase for decision in result.decisions}
    shown = [summary for summary in result.summaries if summary.frame > 0 and phases[summary.frame // 2] is not Phase.TENSION]
    return _strain_bars([float(summary.frame) for summary in shown], shown, "frame") if shown else None


def loaded_strain(result: RunResult, area_mm2: float | None) -> Figure | None:
    """Fig. 13: mean and scatter of strain in the frames under load, over stress where the cross-section is known."""
    loads = {
        2 * decision.pair + member: decision.loads[member].mean_n
        for decision in result.decisions
        if decision.step.phase is Phase.TENSION and decision.loads is not None
        for member in (0, 1)
    }
    shown = [summary for summary in result.summaries if summary.frame in loads]
    if not shown:
        return None
    scale, label = (1.0, "load (N)") if area_mm2 is None else (1.0 / area_mm2, "stress (MPa)")
    return _strain_bars([loads[summary.frame] * scale for summary in shown], shown, label)


def constants(result: RunResult) -> Figure | None:
    """Fig. 14: both elastic constants with two standard uncertainties, by DIC and, if present, by the strain gage."""
    if result.elastic is None:
        return None
    figure = Figure(figsize=(7.0, 2.6), layout="constrained")
    columns = [("DIC", result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio)]
    if result.gage is not None:
        columns.append(("strain gage", result.gage.youngs_modulus_gpa, result.gage.poissons_ratio))
    for axes, place, title in zip(figure.subplots(1, 2), (1, 2), ("Young's modulus (GPa)", "Poisson's ratio"), strict=True):
        for at, row in enumerate(columns):
            constant = row[place]
            assert not isinstance(constant, str)  # the name is the first item
            axes.errorbar(constant.value, at, xerr=2 * constant.sigma, fmt="o", color=(Y_COLOUR, X_COLOUR)[at], capsize=4)
            axes.annotate(
                f"{constant.value:.4g} ± {constant.sigma:.2g}",
                (constant.value, at),
                xytext=(0, 8),
                textcoords="offset points",
                ha="center",
                fontsize=8,
            )
        axes.set_yticks(range(len(columns)), [row[0] for row in columns])
        axes.set_ylim(-0.6, len(columns) - 0.2)
        axes.set_title(title, fontsize=9)
        axes.margins(x=0.3)
        axes.grid(**GRID)
    return figure


def translation_path(result: RunResult) -> Figure | None:
    """Fig. 15: commanded and measured position of the specimen in the unloaded pairs."""
    steps = {decision.pair: decision.step for decision in result.decisions if decision.step.phase is not Phase.TENSION}
    motions = [motion for motion in result.estimate.motions if motion.pair in steps]
    if len(motions) < 2:
        return None
    figure, axes = framed(5.2, 4.6)
    # The first pair is the origin of both paths.
    zero = np.array(steps[motions[0].pair].shift_px)
    commanded = np.array([steps[motion.pair].shift_px for motion in motions]) - zero
    measured, sigma = np.array([motion.shift_px for motion in motions]), np.array([motion.shift_sigma_px for motion in motions])
    axes.plot(*commanded.T, "s--", color="#94a3b8", linewidth=0.8, markersize=6, markerfacecolor="none", label="commanded")
    axes.errorbar(
        *measured.T, xerr=2 * sigma[:, 0], yerr=2 * sigma[:, 1], fmt="o-", color=X_COLOUR, linewidth=0.9, markersize=3.5, label="measured"
    )
    axes.set(xlabel="x (px)", ylabel="y (px)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    off = np.hypot(*(measured - commanded).T)
    axes.set_title(f"{off.max():.2f} px largest distance", fontsize=9)
    axes.legend(frameon=False)
    return figure


def false_strain_figure(result: RunResult, window_points: int) -> Figure | None:
    """Fig. 16: false strain by translations of 5 px along x and along y without correction of the distortion."""
    distortion = result.estimate.distortion
    if min(distortion.grid.shape) < 7 or not distortion.valid.any():
        return None
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    for row, (shift, axis) in zip(figure.subplots(2, 3), (((TRANSLATED_PX, 0.0), "x"), ((0.0, TRANSLATED_PX), "y")), strict=True):
        field = false_strain(distortion, shift, min(window_points, *distortion.grid.shape))
        for axes, name in zip(row, ("exx", "exy", "eyy"), strict=True):
            values = 1e6 * getattr(field, name)
            title = f"{name}, {TRANSLATED_PX:g} px along {axis} (1e-6)"
            draw_map(figure, axes, field.grid.x_px, field.grid.y_px, values, field.valid, title, robust=False)
    return figure


def _strain_bars(over: Sequence[float], summaries: Sequence[StrainSummary], label: str) -> Figure:
    """Mean with its uncertainty above, scatter of the field below."""
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    highest = 0.0
    for name, colour, marker in _COMPONENTS:
        mean, sigma, sd = (
            1e6 * np.array([getattr(getattr(summary, part), name) for summary in summaries]) for part in ("mean", "mean_sigma", "sd")
        )
        above.errorbar(over, mean, 2 * sigma, fmt=marker, color=colour, markersize=4, linewidth=0.9, label=name)
        below.plot(over, sd, marker, color=colour, markersize=4)
        highest = max(highest, float(np.max(sd)))
    above.axhline(0.0, color=INK, linewidth=0.6)
    above.set(ylabel="mean strain (1e-6)")
    above.legend(frameon=False, ncols=3, fontsize=8)
    below.set(xlabel=label, ylabel="sd over field (1e-6)", ylim=(0.0, 1.15 * highest or 1.0))
    for axes in (above, below):
        axes.grid(**GRID)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(f"bars: two standard uncertainties; virtual strain gauge {summaries[-1].vsg_px:.0f} px", fontsize=9)
    return figure


def _without_plane(moved: Displacement, name: str) -> Field:
    """One displacement component minus its best-fit plane; zero at unmeasured points."""
    values = getattr(moved, name)
    x, y = moved.grid.mesh()
    plane = np.stack((np.ones(moved.grid.shape), x - x.mean(), y - y.mean()), axis=-1)
    inside = moved.valid
    if inside.sum() < 3:
        return np.zeros(moved.grid.shape)
    return np.where(inside, values - plane @ np.linalg.lstsq(plane[inside], values[inside], rcond=None)[0], 0.0)


def _smoothed(total: Field, count: Field) -> Field:
    """Mean over a square of points, over measured points only."""
    size = min(SMOOTHED_POINTS, *total.shape)
    weight = np.asarray(ndimage.uniform_filter(count, size, mode="constant"))
    return np.asarray(ndimage.uniform_filter(total, size, mode="constant")) / np.maximum(weight, 1e-9)


def _pair_of_axes(figure: Figure) -> Sequence[Axes]:
    axes = figure.subplots(1, 2)
    for single in axes:
        single.grid(**GRID)
        single.spines[["top", "right"]].set_visible(False)
    return list(axes)


def _shade(axis: int, strength: float) -> tuple[float, float, float, float]:
    red, green, blue = ((0.145, 0.388, 0.922), (0.851, 0.467, 0.024))[axis]
    return (red, green, blue, strength)
