"""Method, subset and step for a frame, and the displacement noise to expect, before any correlation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.frame import PatternQuality
from semlive.data.grid import grid_for
from semlive.data.settings import DicSettings
from semlive.dic.image_quality.quality import GOOD_SIGMA_PX, MIN_SPECKLES_PER_SUBSET, MIN_USABLE, quality
from semlive.dic.image_quality.row_structure import RowStructure, row_structure
from semlive.dic.mask import mask_of
from semlive.dic.reference import central_region
from semlive.dic.row_registration import gradient_scales, smoothed_gradients
from semlive.errors import BadInput
from semlive.inputs.mask_file import Mask
from semlive.kernels import images

Image = NDArray[np.uint8] | NDArray[np.uint16]
Pixels = TypeVar("Pixels", NDArray[np.uint8] | NDArray[np.uint16], NDArray[np.bool_])

SUBSETS_PX = (21, 25, 31, 37, 43, 51, 61, 73, 87, 101)
SUBSETS_PER_EDGE = 8  # along the shorter edge of the frame; larger subsets average most of the field
POINTS_PER_EDGE = 20  # for the prediction
STEPS_PER_SUBSET = 8  # finer steps use the same pixels more often without new information
# Rendered textures of which subsets measure at least 95 % of the matchable points have less than this displacement noise, and at least 2.2
# speckles in a subset; of the real raster pairs with at most 0.5 they measure none (docs/validation/correlation.md).
MAX_SIGMA_PX = 0.05
MIN_SPECKLES = 2.0
MAX_ROW_OFFSET = 0.15  # of the contrast; at 0.14 subsets measure 99 % of rendered speckle, at 0.3 of rendered grains 0.3 %
MIN_ROW_SHIFT_PX = 0.05  # smaller estimates are not significant in a frame of 256 rows
SINGULAR, TINY = 1e-6, 1e-12  # determinant below which a window has texture along one direction only
SMOOTHED_NOISE = (0.031, 0.043)  # fraction of the noise variance in the smoothed derivatives along x and y


@dataclass(frozen=True, slots=True)
class CorrelationChoice:
    """Recommended method, subset and step for one frame.

    Attributes:
        method: ``subset``, or ``global`` where subsets of acceptable size have too little texture or rows differ too much.
        subset_px: recommended edge of a subset; with ``global``, the largest subset of acceptable resolution.
        step_px: recommended distance of POI.
        sigma_u_px: expected standard deviation of u between two such frames from white image noise, median over the frame; with ``global``,
            that of a window of this size, without regularisation. Zero without a pattern.
        sigma_v_px: the same of v.
        usable_fraction: fraction of the POI with sufficient contrast for such subsets.
        rows: differences between rows.
        reason: why this method, with the figures that decide.
    """

    method: Literal["subset", "global"]
    subset_px: int
    step_px: int
    sigma_u_px: float
    sigma_v_px: float
    usable_fraction: float
    rows: RowStructure
    reason: str


def recommend(image: Image, settings: DicSettings | None = None) -> CorrelationChoice:
    """Recommend method, subset and step for pairs of such frames.

    The subset is the smallest with an expected noise of at most 0.02 px and nine speckles. If none of acceptable size has both, the largest
    acceptable one is recommended as long as its noise is at most 0.05 px and it contains two speckles. Acceptable are subsets of at most an
    eighth of the shorter edge of the frame. The global method is recommended if no subset suffices, if the grey offsets of rows exceed
    0.15 of the contrast, or if shifts of rows displace the mean over a subset by more than the noise does.

    The noise is that of white image noise in both frames. Changes of the surface or of the detector between the frames are not in one frame
    and not in the prediction.

    Args:
        image: (height, width) uint8 or uint16.
        settings: region of interest, mask, interpolation and shape function; None: the defaults for the complete frame.

    Raises:
        BadInput: the image has another form, or no subset of 21 px fits.
    """
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise BadInput("the image is no two-dimensional array of uint8 or uint16: give one channel of the grey levels of the detector")
    settings = settings or DicSettings(roi_px=None)
    height, width = image.shape
    mask = mask_of(settings, (height, width))
    part, usable = _evaluated(image, settings), None if mask is None else _evaluated(mask, settings)
    chosen, reason = _subset(part, usable, replace(settings, roi_px=None, mask=None), min(image.shape) / SUBSETS_PER_EDGE)
    rows = row_structure(part)
    subset_px, sigma_px = chosen.grid.subset_px, max(chosen.median_sigma_px)
    reason = reason or _row_reason(rows, chosen)
    step_px = max(subset_px // STEPS_PER_SUBSET, 1)
    if not reason:
        text = f"a subset of {subset_px} px contains {chosen.speckles_per_subset:.1f} speckles and has a noise of {sigma_px:.3f} px"
        return CorrelationChoice("subset", subset_px, step_px, *chosen.median_sigma_px, chosen.usable_fraction, rows, text)
    return CorrelationChoice("global", subset_px, step_px, *_window_sigma(part, chosen), chosen.usable_fraction, rows, reason)


def _evaluated(image: Pixels, settings: DicSettings) -> Pixels:
    """Part of the frame that is evaluated: the subsets of the region of interest, of a large one its central part."""
    if settings.roi_px is not None:
        x0, y0, x1, y1 = settings.roi_px
        half = settings.subset_px // 2
        image = image[max(y0 - half, 0) : y1 + half + 1, max(x0 - half, 0) : x1 + half + 1]
    return image[central_region(image.shape)]


def _candidates(image: Image, mask: Mask | None, settings: DicSettings, max_subset_px: float) -> Iterator[PatternQuality]:
    """Quality with subsets of acceptable size from the smallest on; at least one."""
    height, width = image.shape
    for subset_px in SUBSETS_PX:
        if subset_px > max(max_subset_px, SUBSETS_PX[0]):
            return
        step_px = max((min(height, width) - subset_px) // POINTS_PER_EDGE, 1)
        sized = replace(settings, subset_px=subset_px, step_px=step_px)
        yield quality(image, grid_for(sized, width, height), sized, mask=mask)


def _subset(image: Image, mask: Mask | None, settings: DicSettings, max_subset_px: float) -> tuple[PatternQuality, str]:
    """Quality with the best subset of acceptable size, and why none suffices (empty if it does)."""
    largest: PatternQuality | None = None
    for candidate in _candidates(image, mask, settings, max_subset_px):
        if _sufficient(candidate, GOOD_SIGMA_PX, MIN_SPECKLES_PER_SUBSET):
            return candidate, ""
        largest = candidate
    assert largest is not None
    return largest, "" if _sufficient(largest, MAX_SIGMA_PX, MIN_SPECKLES) else _thin(largest)


def _sufficient(q: PatternQuality, max_sigma_px: float, min_speckles: float) -> bool:
    """Whether nearly all points can be measured with this noise and this number of speckles."""
    return q.usable_fraction >= MIN_USABLE and max(q.median_sigma_px) <= max_sigma_px and q.speckles_per_subset >= min_speckles


def _thin(q: PatternQuality) -> str:
    """Why the largest acceptable subset has too little texture."""
    subset = f"a subset of {q.grid.subset_px} px, the largest of acceptable resolution,"
    if q.usable_fraction < MIN_USABLE:
        return f"{subset} has sufficient contrast at {100 * q.usable_fraction:.0f} % of the points ({100 * MIN_USABLE:.0f} % are needed)"
    if q.speckles_per_subset < MIN_SPECKLES:
        size = f"{q.speckle_x_px:.0f} x {q.speckle_y_px:.0f} px"
        return f"{subset} contains {q.speckles_per_subset:.1f} structures of {size} ({MIN_SPECKLES:.0f} are needed)"
    return f"{subset} has a noise of {max(q.median_sigma_px):.3f} px ({MAX_SIGMA_PX} px is acceptable)"


def _row_reason(rows: RowStructure, q: PatternQuality) -> str:
    """Why rows differ too much for subsets; empty if they do not."""
    if rows.offset_grey > MAX_ROW_OFFSET * q.contrast_grey:
        return f"the grey offset of a row is {rows.offset_grey:.1f} grey levels at a contrast of {q.contrast_grey:.1f} grey levels"
    sigma_px, added_px = max(q.median_sigma_px), rows.shift_px * float(np.sqrt(2.0 / q.grid.subset_px))
    if rows.shift_px > MIN_ROW_SHIFT_PX and added_px > sigma_px:
        return f"rows are shifted by {rows.shift_px:.2f} px, which adds {added_px:.3f} px to the noise of {sigma_px:.3f} px of a subset"
    return ""


def _window_sigma(image: Image, q: PatternQuality) -> tuple[float, float]:
    """Noise of u and v of a window of the size of the subset whose rows have unknown offsets, from smoothed gradients; medians."""
    grey = images.to_float32_grey(image)
    along_x, along_y = smoothed_gradients(grey)
    scale = gradient_scales(grey, along_x, along_y, q.noise_grey)
    gx, gy = (factor * gradient for factor, gradient in zip(scale, (along_x, along_y), strict=True))
    xx, yy, xy = (_within_rows(a, b, q.grid.subset_px) for a, b in ((gx, gx), (gy, gy), (gx, gy)))
    noise2 = q.noise_grey**2
    xx, yy = (np.maximum(energy - s**2 * n * noise2, 0.0) for energy, s, n in zip((xx, yy), scale, SMOOTHED_NOISE, strict=True))
    determinant = xx * yy - xy**2
    measurable = determinant > SINGULAR * np.maximum(xx * yy, TINY)
    if not measurable.any():
        return 0.0, 0.0
    variance = 2.0 * noise2 / q.grid.subset_px**2 / determinant[measurable]
    return float(np.sqrt(np.median(variance * yy[measurable]))), float(np.sqrt(np.median(variance * xx[measurable])))


def _within_rows(a: NDArray[np.float32], b: NDArray[np.float32], edge_px: int) -> NDArray[np.float64]:
    """Mean over a window of the products of a and b about the means of their rows of the window."""
    mean_a, mean_b = (cv2.boxFilter(values, cv2.CV_32F, (edge_px, 1)) for values in (a, b))
    total = cv2.boxFilter(a * b, cv2.CV_64F, (edge_px, edge_px))
    return np.asarray(total - cv2.boxFilter(mean_a * mean_b, cv2.CV_64F, (1, edge_px)), dtype=np.float64)
