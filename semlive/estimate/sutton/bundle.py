"""Bundle adjustment: distortion and all motions at once from translated images (Sutton 2007, equation 10; Schreier 2004)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from semlive.estimate.sutton.surface import Surface

Array = NDArray[np.float64]
# Translations do not determine the affine part, which is a gauge and set to zero; the ridge regularises areas that no translation showed.
GAUGE_WEIGHT = 1.0
RIDGE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class TranslatedImage:
    """Observations of one translated image relative to frame 0.

    Attributes:
        pair: number of its pair.
        before_px: (n, 2) address in frame 0 at which the distortion is evaluated.
        after_px: (n, 2) address in the image.
        moved_px: (n, 2) disparity with drift removed.
    """

    pair: int
    before_px: Array
    after_px: Array
    moved_px: Array


@dataclass(frozen=True, slots=True, eq=False)
class BundleAdjustment:
    """Distortion and motions that were estimated together.

    Attributes:
        surface: the distortion.
        shifts_px: (2,) motion of each image's pair relative to frame 0.
        residual_px: robust standard deviation of the residual, per component.
        covariance: (size, size) of the surface's coefficients, one component, for unit noise of independent points.
        shift_sigma: standard uncertainty of a motion, for unit noise of independent points.
    """

    surface: Surface
    shifts_px: dict[int, Array]
    residual_px: float
    covariance: Array
    shift_sigma: dict[int, float]


def adjust(images: Sequence[TranslatedImage], flat: Surface, grid_px: Array) -> BundleAdjustment:
    """Least squares for all coefficients and motions together.

    Args:
        images: translated images.
        flat: the surface to fill.
        grid_px: (m, 2) positions over which the affine part is held to zero.
    """
    size, count = len(flat.coefficients), len(images)
    normal, right = np.zeros((size + count, size + count)), np.zeros((size + count, 2))
    for at, image in enumerate(images, size):
        rows = flat.rows(image.after_px) - flat.rows(image.before_px)
        normal[:size, :size] += (rows.T @ rows).toarray()
        normal[:size, at] = normal[at, :size] = rows.sum(axis=0)
        normal[at, at] = len(image.moved_px)
        right[:size] += rows.T @ image.moved_px
        right[at] = image.moved_px.sum(axis=0)
    plane = np.column_stack((np.ones(len(grid_px)), (grid_px - grid_px.mean(axis=0)) / np.ptp(grid_px, axis=0)))
    affine = np.asarray((flat.rows(grid_px).T @ np.linalg.pinv(plane).T).T)
    information = max(float(np.trace(normal[:size, :size])) / size, 1.0)
    normal[:size, :size] += GAUGE_WEIGHT * count * len(grid_px) * affine.T @ affine + RIDGE * information * np.eye(size)
    factor = cho_factor(normal, lower=True)
    solution = cho_solve(factor, right)
    covariance = np.asarray(cho_solve(factor, np.eye(size + count)))
    surface = replace(flat, coefficients=np.ascontiguousarray(solution[:size]))
    residual = [
        image.moved_px - solution[at] - surface.at(image.after_px) + surface.at(image.before_px) for at, image in enumerate(images, size)
    ]
    shifts = {image.pair: solution[at] for at, image in enumerate(images, size)}
    sigma = {image.pair: float(np.sqrt(covariance[at, at])) for at, image in enumerate(images, size)}
    return BundleAdjustment(surface, shifts, 1.4826 * float(np.median(np.abs(np.concatenate(residual)))), covariance[:size, :size], sigma)
