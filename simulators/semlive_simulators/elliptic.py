"""Elliptic hole in an infinite elastic plate under tension: exact displacements (Muskhelishvili 1953; Kirsch 1898 for the circle)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class EllipticHole:
    """A hole with its axes along image x and y.

    Attributes:
        x_px: centre, counted from the centre of the frame.
        y_px: likewise.
        semi_x_px: half of its width.
        semi_y_px: half of its height.
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
        """Largest strain along y at the hole's left and right end, as a multiple of that far away (Inglis 1913)."""
        return 1.0 + 2.0 * self.semi_x_px / self.semi_y_px

    def outside(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points' conformal radius |zeta|, 1 on the edge, below 1 inside; x and y from the centre of the frame."""
        return np.abs(self._mapped(x_px, y_px))

    def _mapped(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.complex128]:
        """The zeta of z = R (zeta + m / zeta), the branch that is large far away."""
        size, m = 0.5 * (self.semi_x_px + self.semi_y_px), self._flatness
        z = ((x_px - self.x_px) + 1j * (y_px - self.y_px)) / size
        root = np.sqrt(z * z - 4.0 * m)
        larger: NDArray[np.complex128] = np.where(np.abs(z + root) >= np.abs(z - root), z + root, z - root)
        return 0.5 * larger

    @property
    def _flatness(self) -> float:
        return (self.semi_x_px - self.semi_y_px) / (self.semi_x_px + self.semi_y_px)

    def displacement_px(
        self, x_px: NDArray[np.float64], y_px: NDArray[np.float64], far_strain: NDArray[np.float64] | float, poissons_ratio: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What the hole adds to the displacement of a plate without one, (x, y) in px; plane stress.

        With z = w(zeta) = R (zeta + m / zeta) and kappa = (3 - nu) / (1 + nu): 2 G (u + i v) = kappa phi - w conj(phi' / w') -
        conj(psi), phi = p R / 4 (zeta - (2 + m) / zeta), psi = p R / 2 (zeta - ((1 + m + m^2) zeta^2 + 1) / (zeta (zeta^2 - m))),
        less the plate without a hole, phi = p z / 4 and psi = p z / 2.

        Args:
            x_px: material points, from the centre of the frame; inside the hole the value on its edge.
            y_px: likewise.
            far_strain: strain along y far away, p / E, of a shape that broadcasts.
            poissons_ratio: nu.
        """
        size, m, kappa = 0.5 * (self.semi_x_px + self.semi_y_px), self._flatness, (3.0 - poissons_ratio) / (1.0 + poissons_ratio)
        zeta = self._mapped(x_px, y_px)
        radius = np.abs(zeta)
        zeta = np.where(radius < 1.0, np.where(radius < 1e-9, 1.0, zeta / np.maximum(radius, 1e-9)), zeta)
        z = size * (zeta + m / zeta)
        slope = size * (1.0 - m / zeta**2)
        # For p = 1, the plate without a hole subtracted term by term.
        phi_more = -0.5 * size * (1.0 + m) / zeta
        phi_slope = 0.25 * size * (1.0 + (2.0 + m) / zeta**2)
        psi_more = -0.5 * size * (((1.0 + m + m * m) * zeta**2 + 1.0) / (zeta * (zeta**2 - m)) + m / zeta)
        bent = z * np.conj(phi_slope / slope - 0.25)
        total = kappa * phi_more - bent - np.conj(psi_more)
        # 2 G = E / (1 + nu), p = E far_strain.
        total = total * (1.0 + poissons_ratio) * far_strain
        return total.real, total.imag
