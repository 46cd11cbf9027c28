"""Mask of a configuration: its file is read and checked, and its bytes are embedded, before a run begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import grid_for
from semlive.data.settings import DicSettings
from semlive.errors import BadConfig, BadInput
from semlive.inputs.files import read_regular
from semlive.inputs.mask_file import MASK_PREFIX, MAX_MASK_BYTES, Mask, embedded_mask, read_mask


def with_mask(settings: DicSettings, base: Path) -> DicSettings:
    """Return the settings with the bytes of the mask instead of its path; the same settings without a mask.

    Args:
        settings: of the correlation.
        base: folder to which a relative path refers.

    Raises:
        BadConfig: the file cannot be read, is no mask, or excludes every point of the region of interest.
    """
    if settings.mask is None:
        return settings
    try:
        given = settings.mask
        settings = settings if given.startswith(MASK_PREFIX) else replace(settings, mask=read_mask_file(base / given))
        _require_points(settings)
    except BadInput as error:
        raise BadConfig(f"dic.mask: {error}") from error
    return settings


def read_mask_file(path: Path) -> str:
    """Return a mask file as the text of `DicSettings.mask`.

    Raises:
        BadInput: the file cannot be read, or is no mask.
    """
    try:
        data = read_regular(path, MAX_MASK_BYTES)
    except OSError as error:
        raise BadInput(
            f"{path}: cannot be read ({error.strerror or error}); give a PNG file, as semlive init --test-frame writes it"
        ) from error
    return embedded_mask(data, str(path))


def usable_points(mask: Mask, settings: DicSettings) -> NDArray[np.bool_]:
    """Return (ny, nx) False for the points of the grid with too few pixels outside the mask, as the correlation excludes them.

    Args:
        mask: (height, width) True where a frame may be used.
        settings: subset, step, region of interest and smallest fraction of a subset.

    Raises:
        BadInput: no point of the region of interest fits into a frame of the size of the mask.
    """
    import cv2  # noqa: PLC0415  (few runs have a mask, and the control process needs OpenCV for nothing else)

    height, width = mask.shape
    grid = grid_for(settings, width, height)
    half = settings.subset_px // 2
    # The derivative of a pixel needs its eight neighbours.
    sums = cv2.integral(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)), sdepth=cv2.CV_64F)
    x, y = grid.x_px.astype(np.intp), grid.y_px.astype(np.intp)
    low, high, left, right = y - half, y + half + 1, x - half, x + half + 1
    pixels = sums[np.ix_(high, right)] - sums[np.ix_(low, right)] - sums[np.ix_(high, left)] + sums[np.ix_(low, left)]
    return np.asarray(pixels >= settings.min_valid_fraction * settings.subset_px**2)


def _require_points(settings: DicSettings) -> None:
    """Verify that a point of the region of interest is outside the mask.

    Raises:
        BadInput: there is none.
    """
    assert settings.mask is not None  # by the caller
    points = usable_points(read_mask(settings.mask), settings)
    if not points.any():
        region = "the frame" if settings.roi_px is None else f"dic.roi_px {','.join(map(str, settings.roi_px))}"
        raise BadInput(
            f"the mask excludes all {points.size} points of {region}; draw a smaller mask or another region "
            "(0 is where pixels must not be used)"
        )
