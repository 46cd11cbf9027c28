"""Stage: scale, rotation and angle of the axes in the image, backlash, yaw, and the residual of its moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import PairMotion, RasterDrift
from semlive.errors import IllPosed
from semlive.estimate.joint.outputs.stage_path import StagePath, stage_path
from semlive.qualify.figures.intervals import NORMAL_95, TAILS, about, chi_square_quantile, excess_interval, student_quantile
from semlive.qualify.figures.waves import AT_REST, RowMotion
from semlive.qualify.values import Figure, Result, Trend, Undetermined

Array = NDArray[np.float64]
MIN_MOVES = 5
STAGE_REMEDY = "give the commanded shifts of at least five positions along both axes in frames.csv"
MAX_BACKLASH_SHARE = 0.5
"""Largest backlash as a share of the shortest move after a reversal: a move that does not take it up makes the estimate too small."""
BACKLASH_REMEDY = "approach at least three positions along each axis from either side, by moves of at least twice the backlash"


def stage_results(
    commands_px: Sequence[tuple[float, float] | None],
    motions: Sequence[PairMotion],
    rows: RowMotion = AT_REST,
    spacing: float = 1.0,
    row_sigma_rad: float = 0.0,
    raster: RasterDrift | None = None,
) -> list[Result]:
    """Scale, rotation, angle, residual, backlash and yaw of the stage, or why they are not determined.

    Args:
        commands_px: commanded shift of each pair, px; None where it is not given.
        motions: measured motion of each pair, in the same order.
        rows: motion of the rows.
        spacing: time from pair to pair in intervals of the frames.
        row_sigma_rad: standard uncertainty of the rotation of a pair by motion of the rows.
        raster: change of the raster in the estimate of the motions; None without one.
    """
    given = [(command, motion) for command, motion in zip(commands_px, motions, strict=True) if command is not None]
    if len(given) < MIN_MOVES:
        return [Undetermined("stage", f"{len(given)} commanded positions are given", STAGE_REMEDY)]
    commands, shifts = np.array([command for command, _ in given]), np.array([motion.shift_px for _, motion in given])
    try:
        path = stage_path(commands, shifts)
    except IllPosed as error:
        return [Undetermined("stage", str(error), STAGE_REMEDY)]
    axes = _axes(commands, shifts)
    # The error of the drift from pair to pair adds up.
    variance = np.mean([motion.shift_sigma_px**2 for _, motion in given]) + (rows.mean_sigma_px * spacing) ** 2 * 0.5 * (len(given) - 1)
    return [
        *_path_figures(path, axes, commands, float(variance)),
        *_backlash(axes),
        _yaw([motion for _, motion in given], row_sigma_rad, raster),
    ]


def _path_figures(path: StagePath, axes: tuple[_Axis, _Axis], commands: Array, variance_px2: float) -> list[Figure]:
    freedom = max(2 * len(commands) - 6, 1)
    factor = student_quantile(TAILS[1], freedom)
    squared = path.residual_px**2 * 2 * len(commands)
    low, high = (float(np.sqrt(squared / chi_square_quantile(tail, freedom))) for tail in reversed(TAILS))
    # The drift between pairs is part of the residual: with jitter of the rows of 0.35 px, 0.57 px were stated in place of 0.26 px.
    low = max(low**2 - variance_px2, 0.0) ** 0.5
    half = factor * path.angle_sigma_deg
    scale = [(path.scale_x, factor * path.scale_sigma * path.scale_x), (path.scale_y, factor * path.scale_sigma * path.scale_y)]
    # Backlash is part of the scale if it is not separated from it: the interval of a fit without it contained 20 % of small scales.
    if all(axis.separated for axis in axes):
        scale = [(axis.scale, axis.half_scale) for axis in axes]
    # The angle has the uncertainty of both axes, the rotation that of the x axis.
    inverse = np.linalg.inv(np.cov(commands, rowvar=False))
    half_rotation = half * float(np.sqrt(inverse[0, 0] / np.trace(inverse)))
    note = "backlash, repeatability, and drift between pairs"
    return [
        Figure("stage_scale_x", "scale of the stage along x", *about(*scale[0]), "", Trend.NONE),
        Figure("stage_scale_y", "scale of the stage along y", *about(*scale[1]), "", Trend.NONE),
        Figure("stage_rotation", "rotation of the scan against the stage", *about(path.rotation_deg, half_rotation), "deg", Trend.NONE),
        Figure("stage_angle", "angle of the stage axes in the image", *about(path.angle_deg, half), "deg", Trend.NONE),
        Figure("stage_residual", "error of a stage move", float(np.sqrt(squared / freedom)), low, high, "px", note=note),
    ]


@dataclass(frozen=True, slots=True)
class _Axis:
    """Law of one axis: position = scale * command - side * backlash / 2 + offset, with the side from which the last move came.

    Attributes:
        scale: px in the image per px of command.
        half_scale: half width of its 95 % interval.
        backlash_px: lost motion after a reversal.
        half_backlash_px: half width of its 95 % interval.
        reversal_px: shortest move after a reversal.
        separated: whether the positions separate scale and backlash; without it the other values are 0.
    """

    scale: float = 0.0
    half_scale: float = 0.0
    backlash_px: float = 0.0
    half_backlash_px: float = 0.0
    reversal_px: float = 0.0
    separated: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    """Linear model of the positions along one axis.

    Attributes:
        columns: (n, k) command and side of the moves, their offset, the command along the other axis, and the offset of each run at rest.
        used: (positions,) True at the n positions of the model.
        moved: (n,) True after a commanded move along the axis.
        reversal_px: shortest move after a reversal.
    """

    columns: Array
    used: NDArray[np.bool_]
    moved: NDArray[np.bool_]
    reversal_px: float


def _design(commands: Array, axis: int) -> _Design | None:
    """Model of one axis; None if the positions do not separate scale and backlash."""
    steps = np.diff(commands[:, axis], prepend=commands[:1, axis])
    side, moved = np.sign(steps), steps != 0.0
    if min(np.count_nonzero(side == sign) for sign in (-1.0, 1.0)) < 2:
        return None
    runs = np.where(moved, -1, np.cumsum(moved))
    offsets = [runs == run for run in np.unique(runs[~moved]) if np.count_nonzero(runs == run) > 1]
    used = np.logical_or.reduce([moved, *offsets])
    columns = np.column_stack((commands[:, axis] * moved, -0.5 * side, moved, commands[:, 1 - axis], *offsets))[used].astype(np.float64)
    if len(columns) <= columns.shape[1] or np.linalg.cond(columns) > 1e6:
        return None
    turns, lengths = np.diff(side[moved]) != 0.0, np.abs(steps[moved][1:])
    return _Design(columns, used, moved[used], float(lengths[turns].min()))


def _axes(commands: Array, shifts: Array) -> tuple[_Axis, _Axis]:
    """Laws of both axes, with one scatter of the positions.

    Positions without a commanded move along the axis do not follow its law: the errors of such moves are shorter than the backlash, so the
    table follows those in one direction only, and the side before the first move is not known. With them the intervals of the backlash
    contained 83 % of 1500 simulated ones, and those of the scale 57 %. Each run of them has an offset of its own.

    The directions of the axes are known no better than the positions, so a move along one axis is also seen along the other. Without this
    share, to which the runs at rest contribute, the intervals contained 93.7 % of 23,208 simulated scales and backlashes; with it, 94.9 %.
    """
    turned = np.linalg.lstsq(commands - commands.mean(axis=0), shifts - shifts.mean(axis=0), rcond=None)[0]
    scales = np.linalg.norm(turned, axis=1)
    along = shifts @ np.linalg.inv(turned) * scales  # px in the image along each axis of the stage
    designs = [design for axis in (0, 1) if (design := _design(commands, axis)) is not None]
    if len(designs) < 2:
        return _Axis(), _Axis()
    squares, freedom, solved = 0.0, 0.0, list[tuple[Array, Array]]()
    for design, positions in zip(designs, along.T, strict=True):
        inverse = np.linalg.inv(design.columns.T @ design.columns)
        values = inverse @ design.columns.T @ positions[design.used]
        rest = positions[design.used] - design.columns @ values
        fitted = np.einsum("nk,kl,nl->n", design.columns, inverse, design.columns)
        # A run at rest scatters less than moves do.
        squares += float(np.sum(rest[design.moved] ** 2))
        freedom += float(np.sum(1.0 - fitted[design.moved]))
        solved.append((values, np.sqrt(np.diag(inverse))))
    if freedom < 1.0:
        return _Axis(), _Axis()
    factor = student_quantile(TAILS[1], freedom) * np.sqrt(squares / freedom)
    first, second = (
        _Axis(float(values[0]), factor * float(unit[0]), float(values[1]), factor * float(unit[1]), design.reversal_px, separated=True)
        for design, (values, unit) in zip(designs, solved, strict=True)
    )
    return first, second


def _backlash(axes: tuple[_Axis, _Axis]) -> list[Result]:
    """Backlash of both axes: the table is half of it behind the motor, on the side from which it came."""
    return [_backlash_of(name, axis) for name, axis in zip("xy", axes, strict=True)]


def _backlash_of(name: str, axis: _Axis) -> Result:
    if not axis.separated:
        return Undetermined(f"stage_backlash_{name}", "too few positions were approached from either side", BACKLASH_REMEDY)
    if axis.backlash_px > MAX_BACKLASH_SHARE * axis.reversal_px:
        reason = f"the backlash is not certainly taken up by moves of {axis.reversal_px:.3g} px"
        return Undetermined(f"stage_backlash_{name}", reason, BACKLASH_REMEDY)
    note = "negative: the table moves further after a reversal" if axis.backlash_px + axis.half_backlash_px < 0.0 else ""
    interval = about(axis.backlash_px, axis.half_backlash_px)
    return Figure(f"stage_backlash_{name}", f"backlash of the stage along {name}", *interval, "px", note=note)


def _yaw(motions: Sequence[PairMotion], rows_rad: float, raster: RasterDrift | None) -> Result:
    """Scatter of the rotation of the specimen after a move, without the uncertainty of its measurement and that by the rows.

    A rotation of the raster may be one of the specimen: with row jitter of 0.4 px the estimate had a raster that turned by 1 mrad and a
    specimen that turned back. The interval contains the scatter with and without that of the raster, the value is the smaller one.
    """
    turned = np.array([0.5 * (motion.gradient[1, 0] - motion.gradient[0, 1]) for motion in motions])
    # Rotations are relative to the first pair, which has none of its own.
    noise = np.array([np.hypot(motion.gradient_sigma[1, 0], rows_rad) for motion in motions[1:]])
    if not any(motion.gradient_sigma[1, 0] for motion in motions[1:]):
        return Undetermined("stage_yaw", "the estimate of these frames has no rotation of the specimen", STAGE_REMEDY)
    possible = [turned] if raster is None else [turned, turned + _of_pairs(raster, motions)]
    variances = sorted(float(np.var(one, ddof=1)) for one in possible)
    smallest, largest = (excess_interval(variances[at], float(np.mean(noise**2)), len(turned) - 1) for at in (0, -1))
    value, low, high = *smallest[:2], largest[2]
    # The estimate draws rotations below its noise towards zero: 0.003 mrad were stated as 0 to 0.001 mrad.
    high = float(np.hypot(high, NORMAL_95 * np.sqrt(np.mean(noise**2))))
    return Figure("stage_yaw", "yaw of a stage move", 1e3 * value, 1e3 * low, 1e3 * high, "mrad")


def _of_pairs(raster: RasterDrift, motions: Sequence[PairMotion]) -> Array:
    """(k,) rotation of the raster in each pair."""
    return np.array([raster.rotation_rad[raster.frame // 2 == motion.pair].mean() for motion in motions])
