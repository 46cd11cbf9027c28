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
MAX_AMBIGUOUS_FRACTION = 0.9  # of these points; above, the pattern repeats everywhere, and no method determines the motion
NOT_MEASURABLE = np.zeros(256, dtype=np.bool_)  # by status: no method measures the point, or too few of its pixels are known
NOT_MEASURABLE[[PoiStatus.OUTSIDE_IMAGE, PoiStatus.LOW_CONTRAST, PoiStatus.MASKED]] = True


def too_few_measured(disparity: DisparityMap) -> bool:
    """Whether subsets measured fewer than MIN_MEASURED_FRACTION of the points that have contrast and lie in both frames."""
    measurable = int(np.count_nonzero(~NOT_MEASURABLE[disparity.status]))
    ambiguous = int(np.count_nonzero(disparity.status == PoiStatus.AMBIGUOUS))
    few = int(np.count_nonzero(disparity.valid)) < MIN_MEASURED_FRACTION * measurable
    return few and ambiguous <= MAX_AMBIGUOUS_FRACTION * measurable


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
