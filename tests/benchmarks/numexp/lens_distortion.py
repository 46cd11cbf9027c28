"""Classical lens distortion fitted to the same translated images (equation 7; J. Weng et al., IEEE PAMI 14:965, 1992).

For comparison: an electron column scans through coils and lenses and does not obey these forms, and neither does a wave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.errors import IllPosed
from semlive.estimate.sutton.procedure import SuttonSolution, translated

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LensDistortion:
    """Radial, decentering, prismatic and tangential distortion about the image centre, each in px at the image's corner.

    Attributes:
        centre_px: (2,) centre.
        corner_px: distance of the corner from it, the unit of length below.
        radial_px: (2,) coefficients of r^3 and r^5 along the radius.
        decentering_px: (2,) p of ``(p1 (3 x^2 + y^2) + 2 p2 x y, 2 p1 x y + p2 (x^2 + 3 y^2))``.
        prismatic_px: (2,) s of ``(s1 r^2, s2 r^2)``.
        tangential_px: (2,) coefficients of r^3 and r^5 across the radius (a spiral).
        residual_px: robust standard deviation of the residual of the fit, per component.
    """

    centre_px: Array
    corner_px: float
    radial_px: Array
    decentering_px: Array
    prismatic_px: Array
    tangential_px: Array
    residual_px: float

    def at(self, address_px: Array) -> Array:
        """(n, 2) distortion at addresses (n, 2)."""
        value = np.concatenate((self.radial_px, self.decentering_px, self.prismatic_px, self.tangential_px))
        return _rows((address_px - self.centre_px) / self.corner_px) @ value


def fit_lens_distortion(solution: SuttonSolution) -> LensDistortion:
    """The classical forms and all motions at once, drift being removed as in the solution.

    Raises:
        IllPosed: no translated image.
    """
    state, images = solution.state, translated(solution)
    if not images:
        raise IllPosed("no translated image, so distortion is unknown: add calibration pairs with translations in both directions")
    centre = 0.5 * np.array([state.width_px - 1.0, state.height_px - 1.0])
    corner = float(np.hypot(*centre))
    size, count = 8, len(images)
    normal, right = np.zeros((size + 2 * count,) * 2), np.zeros(size + 2 * count)
    differences = [_rows((image.after_px - centre) / corner) - _rows((image.before_px - centre) / corner) for image in images]
    for at, (image, rows) in enumerate(zip(images, differences, strict=True)):
        own = slice(size + 2 * at, size + 2 * at + 2)
        normal[:size, :size] += np.einsum("nci,ncj->ij", rows, rows)
        normal[:size, own] = rows.sum(axis=0).T
        normal[own, :size] = rows.sum(axis=0)
        normal[own, own] = len(rows) * np.eye(2)
        right[:size] += np.einsum("nci,nc->i", rows, image.moved_px)
        right[own] = image.moved_px.sum(axis=0)
    found = np.asarray(np.linalg.lstsq(normal, right, rcond=1e-12)[0], dtype=np.float64)
    shifts = found[size:].reshape(-1, 2)
    residuals = [image.moved_px - shift - rows @ found[:size] for image, shift, rows in zip(images, shifts, differences, strict=True)]
    residual = 1.4826 * float(np.median(np.abs(np.concatenate(residuals))))
    return LensDistortion(centre, corner, found[0:2], found[2:4], found[4:6], found[6:8], residual)


def _rows(position: Array) -> Array:
    """(n, 2, 8) what each coefficient adds at positions (n, 2) in units of the corner's distance."""
    x, y = position.T
    r2 = x * x + y * y
    along_x = (x * r2, x * r2**2, 3 * x * x + y * y, 2 * x * y, r2, 0 * x, -y * r2, -y * r2**2)
    along_y = (y * r2, y * r2**2, 2 * x * y, x * x + 3 * y * y, 0 * x, r2, x * r2, x * r2**2)
    return np.stack((np.stack(along_x, axis=1), np.stack(along_y, axis=1)), axis=1)
