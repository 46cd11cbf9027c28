"""Elliptic hole in an infinite elastic plate under tension: exact displacements (Muskhelishvili 1953; Kirsch 1898 for the circle)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.kernels.opening import darken, opened, outside


@dataclass(frozen=True, slots=True)
class EllipticHole:
    """A hole with its axes along image x and y.

    Attributes:
        x_px: centre, from the centre of the frame, px.
        y_px: likewise.
        semi_x_px: half axis along x, px.
        semi_y_px: half axis along y, px.
    """

    x_px: float
    y_px: float
    semi_x_px: float
    semi_y_px: float

    def __post_init__(self) -> None:
        if not (self.semi_x_px > 0 and self.semi_y_px > 0):
            raise ValueError(f"half axes must be above 0, not {self.semi_x_px} and {self.semi_y_px}")

    @property
    def concentration(self) -> float:
        """Largest strain along y at both ends of the hole in x, relative to the remote strain (Inglis 1913)."""
        return 1.0 + 2.0 * self.semi_x_px / self.semi_y_px

    @property
    def size_px(self) -> float:
        """R, half the sum of the half axes."""
        return 0.5 * (self.semi_x_px + self.semi_y_px)

    @property
    def flatness(self) -> float:
        """m, the difference of the half axes over their sum."""
        return (self.semi_x_px - self.semi_y_px) / (self.semi_x_px + self.semi_y_px)

    def outside(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Conformal radius |zeta| of points, 1 on the edge, below 1 inside; x and y from the centre of the frame."""
        x_px, y_px = np.broadcast_arrays(x_px - self.x_px, y_px - self.y_px)
        radius = np.empty(x_px.size)
        outside(radius, x_px.ravel(), y_px.ravel(), self.size_px, self.flatness)
        return radius.reshape(x_px.shape)

    def displacement_px(
        self, x_px: NDArray[np.float64], y_px: NDArray[np.float64], far_strain: NDArray[np.float64] | float, poissons_ratio: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Additional displacement by the hole, (x, y) in px; plane stress.

        With z = w(zeta) = R (zeta + m / zeta) and kappa = (3 - nu) / (1 + nu): 2 G (u + i v) = kappa phi - w conj(phi' / w') -
        conj(psi), phi = p R / 4 (zeta - (2 + m) / zeta), psi = p R / 2 (zeta - ((1 + m + m^2) zeta^2 + 1) / (zeta (zeta^2 - m))),
        minus the plate without a hole, phi = p z / 4 and psi = p z / 2; 2 G = E / (1 + nu), p = E far_strain.

        Args:
            x_px: material points, from the centre of the frame; inside the hole the value on its edge.
            y_px: likewise.
            far_strain: remote strain along y, p / E, of a shape that broadcasts.
            poissons_ratio: nu.
        """
        x_px, y_px = np.broadcast_arrays(x_px - self.x_px, y_px - self.y_px)
        u_px, v_px = np.empty(x_px.size), np.empty(x_px.size)
        opened(u_px, v_px, x_px.ravel(), y_px.ravel(), self.size_px, self.flatness, poissons_ratio)
        return u_px.reshape(x_px.shape) * far_strain, v_px.reshape(x_px.shape) * far_strain

    def darkened(
        self, grey: NDArray[np.float64], x_px: NDArray[np.float64], y_px: NDArray[np.float64], level: float, edge_px: float
    ) -> NDArray[np.float64]:
        """Grey levels with the hole, which has a uniform level and a quintic edge of half width about `edge_px`."""
        mixed = grey.ravel().copy()
        darken(mixed, (x_px - self.x_px).ravel(), (y_px - self.y_px).ravel(), self.size_px, self.flatness, level, edge_px)
        return mixed.reshape(grey.shape)
