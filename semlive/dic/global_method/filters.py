"""Band-passed images for the global method: row offsets and shading removed, noise reduced."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
LEVELLING_PX = 4.0  # standard deviation along y of the mean of rows with which the offset of a row is compared


def without_row_offsets(image: Image) -> Image:
    """Return the image without row offsets: the median difference of each row from the mean of the rows around it is subtracted.

    Args:
        image: (height, width) grey levels.
    """
    smooth = cv2.sepFilter2D(image, cv2.CV_32F, np.ones(1), _gaussian(LEVELLING_PX), borderType=cv2.BORDER_REFLECT_101)
    offset = np.median(image - smooth, axis=1)
    return np.asarray(image - offset[:, None], dtype=np.float32)


def _gaussian(sd_px: float) -> NDArray[np.float64]:
    return np.asarray(cv2.getGaussianKernel(2 * int(np.ceil(4.0 * sd_px)) + 1, sd_px), dtype=np.float64)


def smoothed(image: Image, sd_px: float, border: int = cv2.BORDER_REFLECT_101) -> Image:
    """Gaussian filter with a standard deviation in px; the border is mirrored unless stated otherwise."""
    kernel = _gaussian(sd_px)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=border), dtype=np.float32)


def band_pass(image: Image, band: tuple[float, float]) -> Image:
    """Difference of two Gaussian filters.

    Args:
        image: (height, width) grey levels.
        band: standard deviations in px of the filter against noise and of the one whose result is subtracted.
    """
    return np.ascontiguousarray(smoothed(image, band[0]) - smoothed(image, band[1]), dtype=np.float32)
