"""The figures of Sutton et al. (2007), part II, for a run, with measured quantities in place of the simulated truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.experiment import Phase
from semlive.data.results import FrameResult, RunResult
from semlive.data.strain import Displacement, StrainSummary
from semlive.mechanics import false_strain
from semlive.report.figures import MICRO, colour_bar
from semlive.report.maps import ImageScale, colour_range, draw_map, label_lengths, map_sheet
from semlive.report.style import INK, PAGE_INCH, SHEAR_COLOUR, SOFT, X_COLOUR, Y_COLOUR, framed, plain_axes

_COMPONENTS = (("exx", X_COLOUR, "o"), ("eyy", Y_COLOUR, "s"), ("exy", SHEAR_COLOUR, "^"))
SMOOTHED_POINTS = 21
"""Edge of the averaging window of Fig. 7: the noise of frame 0 (0.017 px per point in the simulated run) is common to all frames."""
TRANSLATED_PX = 5.0
"""Translation in Fig. 16."""
MAX_CURVES = 40
"""Largest number of frames in Fig. 1."""
MAX_RESIDUAL_FRAMES = 24
"""Largest number of frames in the mean of Fig. 7; each is corrected again."""
Field = NDArray[np.float64]


def drift_within_frames(result: RunResult) -> Figure:
    """Fig. 1: drift since the first row, frame by frame, over the time in the frame; at most `MAX_CURVES` frames."""
    figure = Figure(figsize=(PAGE_INCH, 2.4), layout="constrained")
    drift, last = result.estimate.drift, max(int(result.estimate.drift.frame.max()), 1)
    panels = figure.subplots(1, 2)
    plain_axes(*panels)
    numbers = spread(np.unique(drift.frame).tolist(), MAX_CURVES)
    for axes, axis in zip(panels, (0, 1), strict=True):
        for number in numbers:
            rows = drift.frame == number
            time_s = drift.time_s[rows] - drift.time_s[rows][0]
            values = drift.drift_px[rows, axis] - drift.drift_px[rows, axis][0]
            axes.plot(time_s, values, color=(X_COLOUR, Y_COLOUR)[axis], alpha=0.15 + 0.75 * number / last, linewidth=0.9)
        axes.set(xlabel="time in the frame (s)", ylabel=f"drift along {'xy'[axis]} since the first row (px)")
    return figure


def spread(numbers: Sequence[int], most: int) -> list[int]:
    """At most `most` of the numbers, evenly spread, the first and the last among them."""
    if len(numbers) <= most:
        return list(numbers)
    return [numbers[round(at)] for at in np.linspace(0, len(numbers) - 1, most)]


def middle_pair(result: RunResult) -> int:
    """Number of the pair of Fig. 6."""
    return result.decisions[len(result.decisions) // 2].pair


def pair_residual(first: FrameResult, second: FrameResult, scale: ImageScale) -> Figure | None:
    """Fig. 6: residual between the two frames of a pair after correction; None if no point was measured in both frames."""
    before, after = first.displacement, second.displacement
    valid = before.valid & after.valid
    if not valid.any():
        return None
    grid = before.grid
    figure, panels = map_sheet(1, 3, grid.ny / grid.nx, PAGE_INCH)
    right = panels[0].pop()
    right.remove()
    off = (after.u_px - before.u_px, after.v_px - before.v_px)
    colours = colour_range([values[valid] for values in off])
    for axes, values, name in zip(panels[0], off, "xy", strict=True):
        draw_map(axes, grid, values, valid, colours, scale)
        axes.set_title(f"along {name}")
    label_lengths(panels, scale)
    colour_bar(figure, panels[0], colours, "residual (px)")
    histogram = figure.add_subplot(1, 3, 3)
    plain_axes(histogram)
    for values, colour, name in zip(off, (X_COLOUR, Y_COLOUR), "xy", strict=True):
        histogram.hist(values[valid], bins=80, histtype="step", color=colour, label=f"{name}: sd {np.std(values[valid]):.4f} px")
    histogram.set(xlabel="residual (px)", ylabel="points")
    histogram.set_ylim(top=1.45 * histogram.get_ylim()[1])
    histogram.legend(frameon=False, loc="upper right")
    histogram.locator_params(axis="x", nbins=4)
    return figure


def residual_frames(result: RunResult) -> list[int]:
    """Numbers of the unloaded frames of Fig. 7, without the first pair; at most `MAX_RESIDUAL_FRAMES`, evenly spread."""
    unloaded = [decision.pair for decision in result.decisions if decision.step.phase is not Phase.TENSION]
    numbers = [2 * pair + member for pair in unloaded for member in (0, 1) if 2 * pair + member > 1]
    return spread(numbers, MAX_RESIDUAL_FRAMES)


def distortion_residual(result: RunResult, frame: Callable[[int], FrameResult], scale: ImageScale) -> Figure | None:
    """Fig. 7: mean residual of the unloaded frames after correction, without rigid motion and mean strain: uncorrected distortion.

    Args:
        result: of the run.
        frame: gives a corrected frame by its number; one frame is in memory at a time.
        scale: unit of lengths.
    """
    numbers, sigma = residual_frames(result), result.estimate.distortion
    if len(numbers) < 2:
        return None
    shape = sigma.grid.shape
    total, count = np.zeros((2, *shape)), np.zeros(shape)
    for number in numbers:
        moved = frame(number).displacement
        total += [_without_plane(moved, name) for name in ("u_px", "v_px")]
        count += moved.valid
    valid = count >= max(2, len(numbers) // 2)
    if valid.sum() < 6:
        return None
    mean = [_smoothed(component, count) for component in total]
    figure, panels = map_sheet(1, 3, shape[0] / shape[1], PAGE_INCH)
    colours = colour_range([component[valid] for component in mean])
    for axes, values, name in zip(panels[0], mean, "xy", strict=False):
        draw_map(axes, sigma.grid, values, valid, colours, scale)
        axes.set_title(f"along {name}: rms {np.sqrt(np.mean(values[valid] ** 2)):.4f} px")
    stated = colour_range([sigma.sigma_px[sigma.valid]])
    draw_map(panels[0][2], sigma.grid, sigma.sigma_px, sigma.valid, stated, scale)
    panels[0][2].set_title("standard uncertainty")
    label_lengths(panels, scale)
    colour_bar(figure, panels[0][:2], colours, "mean residual (px)")
    colour_bar(figure, panels[0][2:], stated, "uncertainty (px)")
    return figure


def drift_over_field(result: RunResult, scale: ImageScale) -> Figure:
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
    fields = [np.interp(time_s, in_frame_s, drift.drift_px[rows, axis] - drift.drift_px[rows, axis][0]) for axis in (0, 1)]
    figure, panels = map_sheet(1, 2, grid.ny / grid.nx, PAGE_INCH)
    everywhere = np.ones(grid.shape, dtype=np.bool_)
    colours = colour_range(fields)
    for axes, values, name in zip(panels[0], fields, "xy", strict=True):
        draw_map(axes, grid, values, everywhere, colours, scale)
        axes.set_title(f"frame {number}, along {name}")
    label_lengths(panels, scale)
    colour_bar(figure, panels[0], colours, "drift since the first row (px)")
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
    figure = Figure(figsize=(PAGE_INCH, 1.7), layout="constrained")
    columns = [("DIC", result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio)]
    if result.gage is not None:
        columns.append(("strain gage", result.gage.youngs_modulus_gpa, result.gage.poissons_ratio))
    panels = figure.subplots(1, 2)
    plain_axes(*panels)
    for axes, place, title in zip(panels, (1, 2), ("Young's modulus (GPa)", "Poisson's ratio"), strict=True):
        for at, row in enumerate(columns):
            constant = row[place]
            assert not isinstance(constant, str)  # the name is the first item
            axes.errorbar(constant.value, at, xerr=2 * constant.sigma, fmt="o", color=(Y_COLOUR, X_COLOUR)[at], capsize=4)
        axes.set_yticks(range(len(columns)), [row[0] for row in columns])
        axes.set_ylim(-0.6, len(columns) - 0.4)
        axes.set_xlabel(title)
        axes.margins(x=0.3)
    return figure


def translation_path(result: RunResult) -> Figure | None:
    """Fig. 15: commanded and measured position of the specimen in the unloaded pairs."""
    steps = {decision.pair: decision.step for decision in result.decisions if decision.step.phase is not Phase.TENSION}
    motions = [motion for motion in result.estimate.motions if motion.pair in steps]
    if len(motions) < 2:
        return None
    figure, axes = framed(0.55 * PAGE_INCH, 3.2)
    # The first pair is the origin of both paths.
    zero = np.array(steps[motions[0].pair].shift_px)
    commanded = np.array([steps[motion.pair].shift_px for motion in motions]) - zero
    measured, sigma = np.array([motion.shift_px for motion in motions]), np.array([motion.shift_sigma_px for motion in motions])
    axes.plot(*commanded.T, "s--", color=SOFT, linewidth=0.8, markersize=6, markerfacecolor="none", label="commanded")
    axes.errorbar(
        *measured.T, xerr=2 * sigma[:, 0], yerr=2 * sigma[:, 1], fmt="o-", color=X_COLOUR, linewidth=0.9, markersize=3.5, label="measured"
    )
    axes.set(xlabel="translation along x (px)", ylabel="translation along y (px)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.legend(frameon=False)
    return figure


def false_strain_figure(result: RunResult, window_points: int, scale: ImageScale) -> Figure | None:
    """Fig. 16: false strain by translations of 5 px along x and along y without correction of the distortion."""
    distortion = result.estimate.distortion
    if min(distortion.grid.shape) < 7 or not distortion.valid.any():
        return None
    shifts = (((TRANSLATED_PX, 0.0), "x"), ((0.0, TRANSLATED_PX), "y"))
    fields = [false_strain(distortion, shift, min(window_points, *distortion.grid.shape)) for shift, _ in shifts]
    names = ("exx", "exy", "eyy")
    colours = colour_range([MICRO * getattr(field, name)[field.valid] for field in fields for name in names])
    figure, panels = map_sheet(2, 3, distortion.grid.ny / distortion.grid.nx, PAGE_INCH)
    for row, field, (_, axis) in zip(panels, fields, shifts, strict=True):
        for axes, name in zip(row, names, strict=True):
            draw_map(axes, field.grid, MICRO * getattr(field, name), field.valid, colours, scale)
            axes.set_title(f"{name}, {TRANSLATED_PX:g} px along {axis}")
    label_lengths(panels, scale)
    colour_bar(figure, [axes for row in panels for axes in row], colours, "false strain (10⁻⁶)")
    return figure


def _strain_bars(over: Sequence[float], summaries: Sequence[StrainSummary], label: str) -> Figure:
    """Mean with its uncertainty above, scatter of the field below."""
    figure = Figure(figsize=(PAGE_INCH, 3.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    highest = 0.0
    for name, colour, marker in _COMPONENTS:
        mean, sigma, sd = (
            MICRO * np.array([getattr(getattr(summary, part), name) for summary in summaries]) for part in ("mean", "mean_sigma", "sd")
        )
        above.errorbar(over, mean, 2 * sigma, fmt=marker, color=colour, markersize=4, linewidth=0.9, label=name)
        below.plot(over, sd, marker, color=colour, markersize=4)
        highest = max(highest, float(np.max(sd)))
    above.axhline(0.0, color=INK, linewidth=0.6)
    above.set(ylabel="mean strain (10⁻⁶)")
    above.legend(frameon=False, ncols=3)
    below.set(xlabel=label, ylabel="sd (10⁻⁶)", ylim=(0.0, 1.15 * highest or 1.0))
    plain_axes(above, below)
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
