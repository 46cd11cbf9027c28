"""Choice between the subset method and the global method."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.settings import DicSettings
from semlive.dic import global_method
from semlive.dic.neighbour_scatter import scatters
from semlive.dic.outlier_rejection import PointMeasurements
from semlive.dic.reference import Reference
from semlive.dic.second_estimate import is_doubtful

MIN_MEASURED_FRACTION = 0.5  # of the points with contrast that both frames show; below, the global method is used in difficult textures
# Speckle gives more than 0.9 of them, six pairs of atomic force microscopes and SEM 0.00 to 0.44.
MIN_MEASURED_DIFFICULT = 0.95  # the same after second estimates: 0.60 to 0.80 in scenes with wrong points of subsets
# In fine speckle points are lost because something hides them or fills both frames equally. With half of the points lost to blank areas
# fixed to the screen, the field followed their edges: 38 of 12,480 points were wrong by up to 4.8 px (hard scene 700004), of subsets none.
MIN_MEASURED_PLAIN = 0.1
DISAGREEMENT_PX = 0.5  # of both methods, plus SIGMAS of the subsets: a field that bridges a crack is off by up to half of its opening
SIGMAS = 3.0
VALUES = ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "covariance_px2", "neighbour_share")  # zero at points that are not valid
# Contrast over slope of the texture, px: speckle of 6.7 px has 3.2 to 3.6, weak textures 4.0 and more.
MAX_LENGTH_PX = 3.78
MAX_NOISE_VARIANCE = 0.33  # of the variance of the texture; noise of 20 grey levels on speckle has 0.28
MAX_MISFIT = 0.03  # of the variance of the texture: residual beyond noise; 0.015 with curvature or saturation
CHANGED_NOISE = 2.0  # times the noise variance of the reference: residual if the current frame has 0.6 times the contrast
MIN_CONTRAST_FRACTION = 0.05  # of the points that both frames show; below, the texture is too weak for subsets everywhere
MAX_AMBIGUOUS_FRACTION = 0.9  # of these points; above, the pattern repeats everywhere, and no method determines the motion


def choose_map(
    disparity: DisparityMap,
    measured: PointMeasurements,
    noise_grey: float,
    settings: DicSettings,
    confirmed: Callable[[], DisparityMap],
    by_global_method: Callable[[], DisparityMap],
    widened: Callable[[], DisparityMap],
) -> DisparityMap:
    """The map of subsets, with second estimates where points are doubtful, or that of the global method if subsets measure too few points.

    A map of subsets without doubtful points gets larger uncertainties if it scatters more than image noise explains.

    Args:
        disparity: map of subsets.
        measured: measurements of its points.
        noise_grey: standard deviation of the noise of the reference.
        settings: method.
        confirmed: returns the map of subsets with second estimates.
        by_global_method: returns the map of the global method.
        widened: returns the map of subsets with the uncertainty that its scatter shows.
    """
    doubtful = is_doubtful(measured, disparity.status, noise_grey)
    lost = settings.method == "auto" and too_few_measured(disparity, MIN_MEASURED_DIFFICULT)
    difficult = lost and is_difficult(measured, noise_grey, settings.subset_px)
    few = lost and too_few_measured(disparity, MIN_MEASURED_FRACTION if difficult else MIN_MEASURED_PLAIN)
    if doubtful and not few:
        disparity = confirmed()
    if few or (difficult and too_few_measured(disparity, MIN_MEASURED_DIFFICULT)):
        other = by_global_method()
        other = other if doubtful else without_contradicted(other, disparity)
        if np.count_nonzero(other.valid) > np.count_nonzero(disparity.valid):
            return other
    if doubtful:
        return confirmed() if few else disparity
    return widened() if scatters(disparity, settings) else disparity


def without_contradicted(of_field: DisparityMap, of_subsets: DisparityMap) -> DisparityMap:
    """The map of the global method, INCONSISTENT within half a subset of points at which subsets measured something else.

    Args:
        of_field: map of the global method.
        of_subsets: map of subsets whose noise model is valid.
    """
    away_px = np.hypot(of_field.u_px - of_subsets.u_px, of_field.v_px - of_subsets.v_px)
    sigma_px = np.maximum(of_subsets.sigma_u_px, of_subsets.sigma_v_px)
    contradicted = of_field.valid & of_subsets.valid & (away_px > DISAGREEMENT_PX + SIGMAS * sigma_px)
    grid = of_field.grid
    reach = max(1, round(0.5 * grid.subset_px / grid.step_px))
    near = np.asarray(ndimage.binary_dilation(contradicted, np.ones((3, 3), dtype=np.bool_), iterations=reach), dtype=np.bool_)
    refused = of_field.valid & near
    values = {name: np.where(refused, 0.0, value) for name in VALUES if (value := getattr(of_field, name)) is not None}
    status = np.where(refused, np.uint8(PoiStatus.INCONSISTENT), of_field.status)
    return dataclasses.replace(of_field, **values, status=status)


def too_few_measured(disparity: DisparityMap, min_fraction: float = MIN_MEASURED_FRACTION) -> bool:
    """Whether subsets measured too few of the points that lie in both frames: of those with contrast, or hardly any has contrast.

    Args:
        disparity: map of subsets.
        min_fraction: smallest sufficient fraction of the points with contrast.
    """
    status = disparity.status
    shown = (status != PoiStatus.OUTSIDE_IMAGE) & (status != PoiStatus.MASKED)
    points = int(np.count_nonzero(shown))
    with_contrast = points - int(np.count_nonzero(status == PoiStatus.LOW_CONTRAST))
    ambiguous = int(np.count_nonzero(status == PoiStatus.AMBIGUOUS))
    few = int(np.count_nonzero(disparity.valid)) < min_fraction * with_contrast
    return (few and ambiguous <= MAX_AMBIGUOUS_FRACTION * with_contrast) or with_contrast < MIN_CONTRAST_FRACTION * points


def is_difficult(measured: PointMeasurements, noise_grey: float, subset_px: int) -> bool:
    """Whether the texture is difficult for subsets: coarse, weak compared with noise, or different in both frames.

    In such a texture a subset that is displaced by half a pixel is not conspicuous. In a pattern of fine speckle it is, and there lost
    points have other causes (discontinuities, hidden or blank parts), which a smooth field does not describe.

    Args:
        measured: measurements by subsets.
        noise_grey: standard deviation of the noise of the reference.
        subset_px: edge of the subsets.
    """
    valid = measured.valid
    if not valid.any():
        return False
    variance = noise_grey**2
    texture = max(float(np.median(measured.contrast[valid])) - variance, 1e-9)
    residual, length_px = float(np.median(measured.residual[valid])), subset_px * float(np.median(measured.length[valid]))
    return (
        length_px > MAX_LENGTH_PX or variance > MAX_NOISE_VARIANCE * texture or residual > CHANGED_NOISE * variance + MAX_MISFIT * texture
    )


def measure_globally(
    reference: Reference, current: NDArray[np.float32], settings: DicSettings, *, reference_frame: int, current_frame: int
) -> DisparityMap:
    """Measure a prepared reference with the global method.

    Args:
        reference: from `prepare`.
        current: (height, width) grey levels of the current frame.
        settings: smallest valid fraction of a subset, and search range.
        reference_frame: number of the reference frame.
        current_frame: number of the current frame.
    """
    sums, width = reference.sums, reference.shape[1]
    return global_method.measure(
        np.ascontiguousarray(sums.planes[:, 0, :width]),
        current,
        reference.grid,
        reference.status,
        np.ascontiguousarray(sums.valid[:, :width]) if len(sums.valid) else None,
        reference_frame=reference_frame,
        current_frame=current_frame,
        min_valid_fraction=settings.min_valid_fraction,
        search_px=settings.search_px,
    )
