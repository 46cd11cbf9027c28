"""Stage: scale, rotation and angle of the axes in the image, backlash, yaw, and the residual of its moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from semlive.data.drift import PairMotion
from semlive.errors import IllPosed
from semlive.estimate.joint.outputs.stage_path import StagePath, stage_path
from semlive.qualify.intervals import TAILS, about, excess_interval
from semlive.qualify.values import Figure, Result, Trend, Undetermined

Array = NDArray[np.float64]
MIN_MOVES = 5
STAGE_REMEDY = "give the commanded shifts of at least five positions along both axes in frames.csv"
MAX_BACKLASH_SHARE = 0.5
"""Largest backlash as a share of the shortest move after a reversal: a move that does not take it up makes the estimate too small."""
BACKLASH_REMEDY = "approach at least three positions along each axis from either side, by moves of at least twice the backlash"


def stage_results(commands_px: Sequence[tuple[float, float] | None], motions: Sequence[PairMotion]) -> list[Result]:
    """Scale, rotation, angle, residual, backlash and yaw of the stage, or why they are not determined.

    Args:
        commands_px: commanded shift of each pair, px; None where it is not given.
        motions: measured motion of each pair, in the same order.
    """
    given = [(command, motion) for command, motion in zip(commands_px, motions, strict=True) if command is not None]
    if len(given) < MIN_MOVES:
        return [Undetermined("stage", f"{len(given)} commanded positions are given", STAGE_REMEDY)]
    commands, shifts = np.array([command for command, _ in given]), np.array([motion.shift_px for _, motion in given])
    try:
        path = stage_path(commands, shifts)
    except IllPosed as error:
        return [Undetermined("stage", str(error), STAGE_REMEDY)]
    return [*_path_figures(path, len(given)), *_backlash(commands, shifts), _yaw([motion for _, motion in given])]


def _path_figures(path: StagePath, count: int) -> list[Figure]:
    freedom = max(2 * count - 6, 1)
    factor = float(stats.t.ppf(TAILS[1], freedom))
    squared = path.residual_px**2 * 2 * count
    low, high = (float(np.sqrt(squared / stats.chi2.ppf(tail, freedom))) for tail in reversed(TAILS))
    half = factor * path.angle_sigma_deg
    half_x, half_y = (factor * path.scale_sigma * scale for scale in (path.scale_x, path.scale_y))
    note = "backlash, repeatability, and drift between pairs"
    return [
        Figure("stage_scale_x", "scale of the stage along x", *about(path.scale_x, half_x), "", Trend.NONE),
        Figure("stage_scale_y", "scale of the stage along y", *about(path.scale_y, half_y), "", Trend.NONE),
        Figure("stage_rotation", "rotation of the scan against the stage", *about(path.rotation_deg, half), "deg", Trend.NONE),
        Figure("stage_angle", "angle of the stage axes in the image", *about(path.angle_deg, half), "deg", Trend.NONE),
        Figure("stage_residual", "error of a stage move", float(np.sqrt(squared / freedom)), low, high, "px", note=note),
    ]


def approach(commands: Array) -> Array:
    """(n,) direction of the last commanded move along one axis before each position: -1 or 1; 0 before the first move."""
    steps = np.sign(np.diff(commands, prepend=commands[:1]))
    last = np.maximum.accumulate(np.where(steps != 0.0, np.arange(len(steps)), 0))
    return np.where(last > 0, steps[last], 0.0)


def _backlash(commands: Array, shifts: Array) -> list[Result]:
    """Backlash of both axes: the table is half of it behind the motor, on the side from which it came.

    Each axis has its own law, position = scale * command - direction * backlash / 2 + offset, with another offset before its first
    move, because the direction of the move to the first position is not known.
    """
    axes = np.linalg.lstsq(commands - commands.mean(axis=0), shifts - shifts.mean(axis=0), rcond=None)[0]
    scales = np.linalg.norm(axes, axis=1)
    along = shifts @ np.linalg.inv(axes) * scales  # px in the image along each axis of the stage
    return [_backlash_of(name, commands[:, axis], along[:, axis]) for axis, name in enumerate("xy")]


def _backlash_of(name: str, command: Array, position: Array) -> Result:
    side = approach(command)
    columns = np.column_stack((-0.5 * side, command, np.ones(len(command)), side == 0.0))
    freedom = len(command) - columns.shape[1]
    if freedom < 1 or min(np.count_nonzero(side == sign) for sign in (-1.0, 1.0)) < 2 or np.linalg.cond(columns) > 1e6:
        return Undetermined(f"stage_backlash_{name}", "too few positions were approached from either side", BACKLASH_REMEDY)
    solved = np.linalg.lstsq(columns, position, rcond=None)[0]
    variance = float(np.sum((position - columns @ solved) ** 2)) / freedom
    reversal_px = float(np.abs(np.diff(command))[(side[1:] != side[:-1]) & (side[:-1] != 0.0)].min())
    if solved[0] > MAX_BACKLASH_SHARE * reversal_px:
        reason = f"the backlash is not certainly taken up by moves of {reversal_px:.3g} px"
        return Undetermined(f"stage_backlash_{name}", reason, BACKLASH_REMEDY)
    half = float(stats.t.ppf(TAILS[1], freedom) * np.sqrt(variance * np.linalg.inv(columns.T @ columns)[0, 0]))
    note = "negative: the table moves further after a reversal" if solved[0] + half < 0.0 else ""
    return Figure(f"stage_backlash_{name}", f"backlash of the stage along {name}", *about(float(solved[0]), half), "px", note=note)


def _yaw(motions: Sequence[PairMotion]) -> Result:
    """Scatter of the rotation of the specimen after a move, without the uncertainty of its measurement."""
    turned = np.array([0.5 * (motion.gradient[1, 0] - motion.gradient[0, 1]) for motion in motions])
    # Rotations are relative to the first pair, which has none of its own.
    noise = np.array([motion.gradient_sigma[1, 0] for motion in motions[1:]])
    if not noise.any():
        return Undetermined("stage_yaw", "the estimate of these frames has no rotation of the specimen", STAGE_REMEDY)
    value, low, high = excess_interval(float(np.var(turned, ddof=1)), float(np.mean(noise**2)), len(turned) - 1)
    return Figure("stage_yaw", "yaw of a stage move", 1e3 * value, 1e3 * low, 1e3 * high, "mrad")
