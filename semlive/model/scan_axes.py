"""Scan axes of unequal length or not at right angles, which make a specimen rotation partly resemble strain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from semlive.model.effect import Axis, Columns, FrameObservation


@dataclass(frozen=True, slots=True)
class ScanAxes:
    """Aspect a and skew b of the scan, ``p = M p_true`` with ``M = 1 + [[a, b], [b, -a]]``.

    Unknown translations do not determine M, so the distortion is given without its affine part. A rotation of the specimen by theta is then
    observed as ``M theta J M^-1 = theta (J + [mu, J])``. Without this effect, rotations of 2e-4 rad and axes that differ by 0.5 % change
    the distortion by 0.01 px; with it, rotations determine the axes.
    """

    @property
    def name(self) -> str:
        """``axes``."""
        return "axes"

    @property
    def size(self) -> int:
        """Number of parameters: a, b."""
        return 2

    @property
    def needs_ideal(self) -> bool:
        """True: the columns hold the rotation and the ideal position."""
        return True

    def columns(self, observation: FrameObservation) -> tuple[Columns, ...]:
        """Columns of a pair that was rotated; none for others."""
        if observation.rotation_rad == 0.0 or observation.ideal_px is None:
            return ()
        twice = 2.0 * observation.rotation_rad * observation.ideal_px
        index = np.broadcast_to(np.arange(2), twice.shape)
        return (
            Columns(Axis.X, index, np.stack((-twice[:, 1], twice[:, 0]), axis=1)),
            Columns(Axis.Y, index, np.stack((-twice[:, 0], -twice[:, 1]), axis=1)),
        )
