"""Pixel size from known translations, from known distances between points, or from microscope metadata.

An isotropic scale does not change strain. Different scales of x and y, or a deviation from perpendicular axes, change strain by the same
fraction. They are the affine part of the distortion, which unknown translations do not determine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.errors import IllPosed

Field = NDArray[np.float64]
STATED_RELATIVE = 0.03  # what makers promise of a displayed magnification is 2 to 5 %
MIN_LEVERAGE = 0.05  # of the larger extent: below, the points or translations lie on a line


@dataclass(frozen=True, slots=True)
class PixelSize:
    """Size and shape of a pixel with standard uncertainties.

    Attributes:
        x_um: pixel size along rows, um.
        x_sigma_um: its standard uncertainty, um.
        y_um: pixel size along columns, um.
        y_sigma_um: its standard uncertainty, um.
        shear_rad: 90 degrees minus the angle between the raster axes, rad.
        shear_sigma_rad: its standard uncertainty, rad.
        residual_um: root mean square residual of the known lengths, um.
    """

    x_um: float
    x_sigma_um: float
    y_um: float
    y_sigma_um: float
    shear_rad: float
    shear_sigma_rad: float
    residual_um: float

    @property
    def aspect(self) -> float:
        """Size along y over that along x, less one."""
        return self.y_um / self.x_um - 1.0


def magnification_from_metadata(pixel_size_um: float, relative_sigma: float = STATED_RELATIVE) -> PixelSize:
    """Square pixel with the size stated in the file and the relative uncertainty stated by manufacturers."""
    if not pixel_size_um > 0:
        raise IllPosed(f"a pixel of {pixel_size_um} um is none: give the scale that the microscope states")
    sigma = pixel_size_um * relative_sigma
    return PixelSize(pixel_size_um, sigma, pixel_size_um, sigma, 0.0, relative_sigma, 0.0)


def magnification_from_translations(moved_um: Field, shifts_px: Field, sigma_um: float = 0.0, sigma_px: float = 0.0) -> PixelSize:
    """Pixel size from translations known in both units; the angle between stage and raster is free.

    Fits ``moved = M shift + offset``. The metric ``M^T M`` contains sizes and angle of the raster axes but no rotation.

    Args:
        moved_um: (n, 2) known positions of the specimen, um.
        shifts_px: (n, 2) measured image shifts at these positions, corrected for drift, px.
        sigma_um: standard uncertainty of a known position, per axis, um.
        sigma_px: standard uncertainty of a measured shift, per axis, px.

    Raises:
        IllPosed: fewer than four positions, or all on a line.
    """
    count = len(shifts_px)
    spread = shifts_px - shifts_px.mean(axis=0) if count else shifts_px
    _need_area(spread, count, 4, "translations")
    solved = np.linalg.lstsq(spread, moved_um - moved_um.mean(axis=0), rcond=None)[0]
    matrix = solved.T
    residual = moved_um - moved_um.mean(axis=0) - spread @ solved
    scatter = float(np.sum(residual**2)) / max(2 * count - 6, 1)
    stated = sigma_um**2 + (sigma_px * float(np.sqrt(abs(np.linalg.det(matrix))))) ** 2
    variance = np.linalg.inv(spread.T @ spread) * max(scatter, stated)
    metric = matrix.T @ matrix
    # d metric = dM^T M + M^T dM, with the rows of dM independent and each of covariance `variance`.
    jacobian = np.zeros((3, 4))
    for at, (row, column) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        step = np.zeros((2, 2))
        step[row, column] = 1.0
        change = step.T @ matrix + matrix.T @ step
        jacobian[:, at] = change[0, 0], change[1, 1], change[0, 1]
    covariance = jacobian @ np.kron(np.eye(2), variance) @ jacobian.T
    return _pixel(np.array([metric[0, 0], metric[1, 1], metric[0, 1]]), covariance, float(np.sqrt(np.mean(residual**2))))


def magnification_from_distances(points_px: Field, pairs: NDArray[np.int64], distances_um: Field, sigma_um: float = 0.0) -> PixelSize:
    """Pixel size from known distances between points of one image.

    A squared distance is linear in the metric of a pixel: ``d^2 = Gxx dx^2 + Gyy dy^2 + 2 Gxy dx dy``.

    Args:
        points_px: (n, 2) positions of the points, corrected for drift and distortion, px.
        pairs: (m, 2) indices of the two points of each distance.
        distances_um: (m,) known distances, um.
        sigma_um: standard uncertainty of one distance, um.

    Raises:
        IllPosed: fewer than three distances, or all along one line.
    """
    between = points_px[pairs[:, 0]] - points_px[pairs[:, 1]]
    _need_area(np.concatenate((between, -between)), len(pairs), 4, "distances")
    rows = np.column_stack((between[:, 0] ** 2, between[:, 1] ** 2, 2 * between[:, 0] * between[:, 1]))
    # An error of d is one of 2 d in d^2.
    weight = 1.0 / (2.0 * distances_um)
    weighted = rows * weight[:, None]
    metric, _, rank, _ = np.linalg.lstsq(weighted, distances_um**2 * weight, rcond=None)
    if rank < 3 or metric[0] <= 0 or metric[1] <= 0:
        raise IllPosed("the known distances run along two directions at most: add diagonal ones, or points off the lines")
    residual = distances_um - np.sqrt(np.maximum(rows @ metric, 0.0))
    variance = max(float(np.sum(residual**2)) / max(len(pairs) - 3, 1), sigma_um**2)
    covariance = np.asarray(np.linalg.inv(weighted.T @ weighted) * variance, dtype=np.float64)
    return _pixel(np.asarray(metric, dtype=np.float64), covariance, float(np.sqrt(np.mean(residual**2))))


def _pixel(metric: Field, covariance: Field, residual_um: float) -> PixelSize:
    """Sizes and angle from the metric (Gxx, Gyy, Gxy) and its covariance."""
    gxx, gyy, gxy = (float(value) for value in metric)
    size_x, size_y = float(np.sqrt(gxx)), float(np.sqrt(gyy))
    shear = gxy / (size_x * size_y)
    slopes = np.array(
        [[0.5 / size_x, 0.0, 0.0], [0.0, 0.5 / size_y, 0.0], [-0.5 * shear / gxx, -0.5 * shear / gyy, 1.0 / (size_x * size_y)]]
    )
    sigma = np.sqrt(np.clip(np.diag(slopes @ covariance @ slopes.T), 0.0, None))
    return PixelSize(size_x, float(sigma[0]), size_y, float(sigma[1]), float(np.arcsin(shear)), float(sigma[2]), residual_um)


def _need_area(spread: Field, count: int, least: int, quantity: str) -> None:
    extent = np.linalg.svd(spread, compute_uv=False) if count else np.zeros(2)
    if count < least or extent[-1] <= MIN_LEVERAGE * extent[0]:
        raise IllPosed(
            f"{count} {quantity} reaching {extent[0]:.3g} px along one direction and {extent[-1]:.3g} px across do not tell the size "
            f"of a pixel in x and y: give at least {least} in two directions"
        )
