"""Stage: scale, rotation and angle of the axes in the image, and the residual of its moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from semlive.data.drift import PairMotion
from semlive.errors import IllPosed
from semlive.estimate.joint.outputs.stage_path import stage_path
from semlive.qualify.intervals import TAILS, about
from semlive.qualify.values import Figure, Result, Trend, Undetermined

Array = NDArray[np.float64]
MIN_MOVES = 5


def stage_results(commands_px: Sequence[tuple[float, float] | None], motions: Sequence[PairMotion]) -> list[Result]:
    """Scale, rotation, angle and residual of the stage, or why they are not determined.

    Args:
        commands_px: commanded shift of each pair, px; None where it is not given.
        motions: measured motion of each pair, in the same order.
    """
    given = [(command, motion.shift_px) for command, motion in zip(commands_px, motions, strict=True) if command is not None]
    remedy = "give the commanded shifts of at least five positions along both axes in frames.csv"
    if len(given) < MIN_MOVES:
        return [Undetermined("stage", f"{len(given)} commanded positions are given", remedy)]
    commands, shifts = np.array([command for command, _ in given]), np.array([shift for _, shift in given])
    try:
        path = stage_path(commands, shifts)
    except IllPosed as error:
        return [Undetermined("stage", str(error), remedy)]
    freedom = max(2 * len(given) - 6, 1)
    factor = float(stats.t.ppf(TAILS[1], freedom))
    squared = path.residual_px**2 * 2 * len(given)
    low, high = (float(np.sqrt(squared / stats.chi2.ppf(tail, freedom))) for tail in reversed(TAILS))
    residual = float(np.sqrt(squared / freedom))
    half = factor * path.angle_sigma_deg
    half_x, half_y = (factor * path.scale_sigma * scale for scale in (path.scale_x, path.scale_y))
    return [
        Figure("stage_scale_x", "scale of the stage along x", *about(path.scale_x, half_x), "", Trend.NONE),
        Figure("stage_scale_y", "scale of the stage along y", *about(path.scale_y, half_y), "", Trend.NONE),
        Figure("stage_rotation", "rotation of the scan against the stage", *about(path.rotation_deg, half), "deg", Trend.NONE),
        Figure("stage_angle", "angle of the stage axes in the image", *about(path.angle_deg, half), "deg", Trend.NONE),
        Figure(
            "stage_residual", "error of a stage move", residual, low, high, "px", note="backlash, repeatability, and drift between pairs"
        ),
    ]
