"""Choice between the subset method and the global method."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.settings import DicSettings
from semlive.dic import global_method
from semlive.dic.reference import Reference

MIN_MEASURED_FRACTION = 0.5  # of the points with contrast that both frames show; below, the global method is used
# Speckle gives more than 0.9 of them, six pairs of atomic force microscopes and SEM 0.00 to 0.44.
MIN_CONTRAST_FRACTION = 0.05  # of the points that both frames show; below, the texture is too weak for subsets everywhere
MAX_AMBIGUOUS_FRACTION = 0.9  # of these points; above, the pattern repeats everywhere, and no method determines the motion


def too_few_measured(disparity: DisparityMap) -> bool:
    """Whether subsets measured too few of the points that lie in both frames: of those with contrast, or hardly any has contrast."""
    status = disparity.status
    shown = (status != PoiStatus.OUTSIDE_IMAGE) & (status != PoiStatus.MASKED)
    points = int(np.count_nonzero(shown))
    with_contrast = points - int(np.count_nonzero(status == PoiStatus.LOW_CONTRAST))
    ambiguous = int(np.count_nonzero(status == PoiStatus.AMBIGUOUS))
    few = int(np.count_nonzero(disparity.valid)) < MIN_MEASURED_FRACTION * with_contrast
    return (few and ambiguous <= MAX_AMBIGUOUS_FRACTION * with_contrast) or with_contrast < MIN_CONTRAST_FRACTION * points


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
