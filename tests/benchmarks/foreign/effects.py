"""Effects that are hidden in a foreign series, from their physics only: nothing is shared with the estimator or the diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """Where and when the beam observes the points of a frame.

    Attributes:
        x_px: address, column.
        y_px: address, row.
        time_s: time since the start of the run, s.
        material_px: position of the points on the specimen in the first frame, column and row.
        distortion_px: distortion at the addresses, along x and y.
        raster_px: width and height of the frame.
    """

    x_px: Array
    y_px: Array
    time_s: Array
    material_px: tuple[Array, Array]
    distortion_px: tuple[Array, Array]
    raster_px: tuple[int, int]


Hidden = Callable[[Visit], tuple[Array, Array]]
"""Displacement of the beam, px."""


def scaling_distortion(change: float, matrix_px: Sequence[Sequence[float]], end_s: float) -> Hidden:
    """The distortion with its own affine part grows by a fraction: saturating with a third of the run.

    Args:
        change: relative change at the end of the run.
        matrix_px: [[xx, xy], [yx, yy]], displacement half a frame from the centre by the affine part of the distortion, px.
        end_s: end of the run, s.
    """

    def displacement(visit: Visit) -> tuple[Array, Array]:
        width, height = visit.raster_px
        a, b = 2.0 * visit.x_px / width - 1.0, 2.0 * visit.y_px / height - 1.0
        grown = change * -np.expm1(-3.0 * visit.time_s / end_s) / -np.expm1(-3.0)
        (xx, xy), (yx, yy) = matrix_px
        u, v = visit.distortion_px
        return grown * (u + xx * a + xy * b), grown * (v + yx * a + yy * b)

    return displacement


@dataclass(frozen=True, slots=True)
class Spot:
    """A charged spot of the specimen.

    Attributes:
        x_px: position on the specimen, column.
        y_px: row.
        width_px: distance at which its deflection is largest.
        peak_px: largest deflection at the end of the run, px.
        charging: time constant, as a fraction of the run.
    """

    x_px: float
    y_px: float
    width_px: float
    peak_px: float
    charging: float


def charged_spots(spots: Sequence[Spot], end_s: float) -> Hidden:
    """Deflection by line charges of finite radius, each charging exponentially: radial, q r / (r^2 + w^2)."""

    def displacement(visit: Visit) -> tuple[Array, Array]:
        total = np.zeros_like(visit.x_px), np.zeros_like(visit.x_px)
        for spot in spots:
            dx, dy = visit.material_px[0] - spot.x_px, visit.material_px[1] - spot.y_px
            charge = np.expm1(-visit.time_s / (spot.charging * end_s)) / np.expm1(-1.0 / spot.charging)
            strength = 2.0 * spot.peak_px * charge * spot.width_px / (dx**2 + dy**2 + spot.width_px**2)
            total = total[0] + strength * dx, total[1] + strength * dy
        return total

    return displacement


def changing_raster(magnification: float, rotation_rad: float, end_s: float) -> Hidden:
    """A magnification that saturates with a third of the run, and a rotation that grows in proportion to time, about the centre.

    Args:
        magnification: relative change at the end of the run.
        rotation_rad: rotation at the end of the run.
        end_s: end of the run, s.
    """

    def displacement(visit: Visit) -> tuple[Array, Array]:
        width, height = visit.raster_px
        x, y = visit.x_px - width / 2.0, visit.y_px - height / 2.0
        grown = magnification * -np.expm1(-3.0 * visit.time_s / end_s) / -np.expm1(-3.0)
        turned = rotation_rad * visit.time_s / end_s
        return grown * x - turned * y, grown * y + turned * x

    return displacement


def together(*parts: Hidden) -> Hidden:
    """The sum of several effects."""

    def displacement(visit: Visit) -> tuple[Array, Array]:
        moved = [part(visit) for part in parts]
        return sum((u for u, _ in moved), np.zeros_like(visit.x_px)), sum((v for _, v in moved), np.zeros_like(visit.x_px))

    return displacement
