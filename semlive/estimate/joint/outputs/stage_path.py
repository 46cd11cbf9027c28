"""Comparison of commanded stage positions with image shifts: scale, angle between the axes, residual (Sutton 2007, Fig. 15)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import PairMotion
from semlive.data.notes import Note, NoteCode, information
from semlive.errors import IllPosed

Field = NDArray[np.float64]
MIN_ACROSS = 0.05  # of the larger extent: below, the commands lie on a line


@dataclass(frozen=True, slots=True)
class StagePath:
    """Fit of ``shift = S command + offset``, derived from the columns of S.

    Attributes:
        scale_x: pixels per unit of command along the x axis of the stage.
        scale_y: pixels per unit of command along the y axis of the stage.
        scale_sigma: relative standard uncertainty of both scales.
        angle_deg: imaged angle between the stage axes, deg; 90 for a square stage and an undistorted image.
        angle_sigma_deg: standard uncertainty of the angle, deg.
        rotation_deg: rotation of the x axis of the stage in the image, deg, positive from x towards y.
        residual_px: root mean square residual per axis, px.
    """

    scale_x: float
    scale_y: float
    scale_sigma: float
    angle_deg: float
    angle_sigma_deg: float
    rotation_deg: float
    residual_px: float

    def message(self) -> str:
        """One sentence for the operator."""
        ratio = f"{self.scale_y / self.scale_x:.4f} +- {1.4 * self.scale_sigma:.2g}"
        return (
            f"translation path: {self.scale_x:.4g} px/um along the stage's x, {self.scale_y:.4g} along y (ratio {ratio}), "
            f"axes at {self.angle_deg:.2f} +- {self.angle_sigma_deg:.2g} deg, turned by {self.rotation_deg:.2f} deg in the picture; "
            f"{self.residual_px:.2g} px rms are left of a straight stage (its own errors and drift between pairs)"
        )


def stage_path(commands_um: Field, shifts_px: Field) -> StagePath:
    """Fit measured shifts to commanded positions.

    Args:
        commands_um: (n, 2) commanded positions, um.
        shifts_px: (n, 2) measured shifts, px, including drift between motions.

    Raises:
        IllPosed: fewer than four positions, or all on a line.
    """
    count = len(commands_um)
    spread = commands_um - commands_um.mean(axis=0) if count else commands_um
    extent = np.linalg.svd(spread, compute_uv=False) if count else np.zeros(2)
    if count < 4 or extent[-1] <= MIN_ACROSS * extent[0]:
        raise IllPosed(f"{count} commanded positions do not span an area: the stage's scale and angle need four in two directions")
    measured_px = shifts_px - shifts_px.mean(axis=0)
    solved = np.linalg.lstsq(spread, measured_px, rcond=None)[0]
    residual = measured_px - spread @ solved
    along_x, along_y = solved  # where the picture goes for one unit along the stage's x, y
    size = np.linalg.norm(solved, axis=1)
    variance = float(np.sum(residual**2)) / max(2 * count - 6, 1) * np.diag(np.linalg.inv(spread.T @ spread))
    relative = np.sqrt(variance) / size
    cosine = float(np.clip(along_x @ along_y / (size[0] * size[1]), -1.0, 1.0))
    return StagePath(
        float(size[0]), float(size[1]), float(relative.max()), float(np.degrees(np.arccos(cosine))), float(np.degrees(np.hypot(*relative))),
        float(np.degrees(np.arctan2(along_x[1], along_x[0]))), float(np.sqrt(np.mean(residual**2))),
    )  # fmt: skip


def stage_path_notes(commands: Iterable[tuple[int, tuple[float, float]]], motions: Sequence[PairMotion]) -> tuple[Note, ...]:
    """Note on the stage path if the commanded positions of the pairs (pair, um) allow a fit; empty otherwise."""
    measured = {motion.pair: motion.shift_px for motion in motions}
    matched = [(command, measured[pair]) for pair, command in commands if pair in measured]
    if len(matched) < 5:
        return ()
    try:
        path = stage_path(np.array([value for value, _ in matched]), np.array([value for _, value in matched]))
    except IllPosed:
        return ()
    return (information(NoteCode.STAGE_PATH, path.message()),)
