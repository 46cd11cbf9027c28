"""Second and third estimate of doubtful points: the same subsets in two band-passed copies of both frames.

In many images the difference of two frames is more than white noise: rows jump or change in brightness, another detector or a changed
surface. The residual of every subset is then larger than noise explains, the Gauss-Newton covariance understates the error by a factor
of 6 to 12, and the outlier rejection refuses correct points. Fine and coarse structure are affected differently by such changes, and by
edges of what does not move with the subset. Points at which both bands confirm the displacement are kept, with the scatter between the
bands as part of their uncertainty; other doubtful points stay refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.outlier_rejection import HIGH_NOISE_VARIANCE, PointMeasurements
from semlive.dic.reference import Reference, gradient_gain
from semlive.kernels import images
from semlive.kernels.local_planes import fit_local_planes
from semlive.kernels.subset_matching import interface
from semlive.kernels.subset_matching.icgn import SEEDED, SKIP
from semlive.kernels.subset_matching.warp import AFFINE

MIN_DOUBTFUL = (
    0.45  # of the converged points refused: the noise model is not valid; 0.51 to 1 on AFM frames, 0.32 at most in 40 hard scenes
)
BANDS = ((1 / 40, 1 / 8), (1 / 20, 1 / 5))  # standard deviations of both filters of each band, in subsets
MIN_BAND_ZNCC = 0.5  # a band contains less contrast and more noise
AGREEMENT_PX = 0.3  # for subsets of REFERENCE_SUBSET_PX, plus SIGMAS of noise; without it, errors up to 6 px agreed within 1 px
REFERENCE_SUBSET_PX = 41.0
SIGMAS = 3.0
MAX_TRAVEL_PX = 4.0
SCATTER_FACTOR = 4.0  # variance of the error relative to the mean squared difference of the bands, on six pairs of AFM and STM frames
MIN_CONFIRMED = 0.5  # fraction of the neighbours within half a subset that the bands confirm, too


@dataclass(frozen=True, slots=True, eq=False)
class SecondEstimates:
    """Differences of the estimates in two bands from the estimate in the frames.

    Attributes:
        difference_px: (bands, ny, nx, 2) u and v; zero where not found.
        found: (bands, ny, nx) whether the band converged.
    """

    difference_px: NDArray[np.float64]
    found: NDArray[np.bool_]


def is_doubtful(measured: PointMeasurements, verdict: NDArray[np.uint8], noise_grey: float) -> bool:
    """Whether so many converged points are refused that the noise model is not valid for the map.

    Not where noise hides the edges of blank areas: there second estimates agree on wrong points, too.

    Args:
        measured: measurements of the map.
        verdict: (ny, nx) status from outlier rejection.
        noise_grey: standard deviation of the noise of the reference.
    """
    valid = measured.valid
    contrast = float(np.median(measured.contrast[valid])) if valid.any() else 0.0
    if noise_grey**2 > HIGH_NOISE_VARIANCE * max(contrast - noise_grey**2, 0.0):
        return False
    refused = valid & ((verdict == PoiStatus.LOW_ZNCC) | (verdict == PoiStatus.INCONSISTENT))
    return bool(refused.sum() >= MIN_DOUBTFUL * max(int(valid.sum()), 1))


def second_estimates(
    reference: Reference, current: NDArray[np.float32], solutions: interface.Solutions, settings: DicSettings
) -> SecondEstimates:
    """Correlate the converged points again in two bands, from their solutions.

    Args:
        reference: from `prepare`.
        current: (height, width) grey levels of the current frame without their mean.
        solutions: of the frames.
        settings: tolerance and iterations.
    """
    sums, grid = reference.sums, reference.grid
    f = np.ascontiguousarray(sums.planes[:, 0, : sums.width_px])
    usable = np.ascontiguousarray(sums.valid[:, : sums.width_px]) if sums.valid.size else None
    valid = solutions.status == PoiStatus.CONVERGED
    difference, found = np.zeros((len(BANDS), *grid.shape, 2)), np.zeros((len(BANDS), *grid.shape), dtype=np.bool_)
    for k, widths in enumerate(BANDS):
        fine, coarse = (width * grid.subset_px for width in widths)
        first, second = (_band(image, fine, coarse) for image in (f, current))
        gains = gradient_gain(first, 1, 0.0, usable), gradient_gain(first, 0, 0.0, usable)
        band = interface.subset_sums(
            first,
            x0_px=grid.x0_px,
            y0_px=grid.y0_px,
            step_px=grid.step_px,
            shape=grid.shape,
            half_px=grid.subset_px // 2,
            parameters=AFFINE,
            gains=gains,
            valid=usable,
        )
        again = interface.Solutions(
            parameters=np.zeros((*grid.shape, AFFINE)),
            zncc=np.zeros(grid.shape),
            status=np.full(grid.shape, PoiStatus.NO_SEED, dtype=np.uint8),
            iterations=np.zeros(grid.shape, dtype=np.int32),
        )
        interface.correlate(
            band,
            images.interpolator(second),
            np.where(valid & (band.variance_u > 0.0), SEEDED, SKIP).astype(np.uint8),
            np.ascontiguousarray(solutions.parameters),
            again,
            max_iterations=settings.max_iterations,
            tolerance_px=settings.tolerance_px,
            min_zncc=MIN_BAND_ZNCC,
            max_travel_px=MAX_TRAVEL_PX,
        )
        found[k] = again.status == PoiStatus.CONVERGED
        difference[k] = np.where(found[k][..., None], (again.parameters - solutions.parameters)[..., [0, 3]], 0.0)
    return SecondEstimates(difference, found)


def _band(image: NDArray[np.float32], fine_px: float, coarse_px: float) -> NDArray[np.float32]:
    """Difference of two Gaussian filters of an image."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), fine_px) - cv2.GaussianBlur(image, (0, 0), coarse_px), dtype=np.float32)


def confirm(
    measured: PointMeasurements, verdict: NDArray[np.uint8], second: SecondEstimates, grid: Grid
) -> tuple[PointMeasurements, NDArray[np.uint8]]:
    """Return the measurements with larger uncertainties, and the status after comparison with the second estimates.

    Points at which both bands agree with the frames, as for most of their neighbours and with a plane through these, are CONVERGED. Of
    the others the status remains; a point that outlier rejection accepted, but a band contradicts, is INCONSISTENT.

    Args:
        measured: measurements of the map.
        verdict: (ny, nx) status from outlier rejection.
        second: from `second_estimates`.
        grid: grid of the points.
    """
    distance = np.hypot(second.difference_px[..., 0], second.difference_px[..., 1])
    limit = AGREEMENT_PX * grid.subset_px / REFERENCE_SUBSET_PX + SIGMAS * measured.sigma_px
    agree = measured.valid & np.all(second.found & (distance <= limit), axis=0)
    width = 2 * max(1, round(0.5 * grid.subset_px / grid.step_px)) + 1

    def near(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.blur(values, (width, width), borderType=cv2.BORDER_CONSTANT), dtype=np.float64)

    count = np.maximum(near(agree.astype(np.float64)), 1e-9)
    points = near(np.ones(grid.shape))
    confirmed = agree & (count >= MIN_CONFIRMED * points)
    squares = np.mean(second.difference_px**2, axis=0) * agree[..., None]
    own = SCATTER_FACTOR * np.maximum(np.dstack([near(np.ascontiguousarray(squares[..., k])) / count for k in range(2)]), squares)
    sigma_u, sigma_v = np.sqrt(measured.sigma_u_px**2 + own[..., 0]), np.sqrt(measured.sigma_v_px**2 + own[..., 1])
    if confirmed.any():
        u_px, v_px = (np.ascontiguousarray(values, dtype=np.float64) for values in (measured.u_px, measured.v_px))
        u, v, _, _ = fit_local_planes(u_px, v_px, confirmed, confirmed, width // 2)
        away = np.hypot(u_px[confirmed] - u, v_px[confirmed] - v)
        tolerance = AGREEMENT_PX * grid.subset_px / REFERENCE_SUBSET_PX + SIGMAS * np.maximum(sigma_u, sigma_v)[confirmed]
        confirmed[confirmed] = away <= tolerance  # static structure agrees in both bands, too, but not with its neighbours
    status = verdict.copy()
    refused = (verdict == PoiStatus.LOW_ZNCC) | (verdict == PoiStatus.INCONSISTENT)
    status[confirmed & refused] = PoiStatus.CONVERGED
    status[measured.valid & ~agree & (verdict == PoiStatus.CONVERGED)] = PoiStatus.INCONSISTENT
    return replace(measured, sigma_u_px=sigma_u, sigma_v_px=sigma_v), status
