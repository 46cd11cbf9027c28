"""Grey levels of any image file, for correlation without an experiment.

`frames` reads the frames of an experiment, which must be finished scans in grey with known times. This module converts colour to
luminance, accepts uniform rows, and reads other formats (JPEG, BMP) too.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images.frames import parse_tiff, parsed_info, tiff_to_greyscale
from semlive.formats.vendors import greyscale, png, tiff, tiff_pages, tiff_pixels

Grey = NDArray[np.uint8] | NDArray[np.uint16]

# Correlation does not use the scan, so any value is valid for files without metadata.
NO_SCAN = ScanProfile(dwell_time_s=1e-9, row_time_s=1.0, frame_time_s=None, pixel_size_m=1.0)
_LUMINANCE = (0.299, 0.587, 0.114)  # of red, green, blue: ITU-R BT.601


def read_picture(data: bytes, name: str, number: int | None = None) -> Grey:
    """Return the grey levels of an image file, (height, width); a databar is cropped if the header contains its height.

    Args:
        data: bytes of the file.
        name: file name, for messages.
        number: which image of a TIFF file to read, from 1; None if it contains only one frame.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    if tiff.is_tiff(data):
        page = tiff_pages.find_page(data, name, number)
        pixels = tiff_pixels.read_pixels(data, name, page)
        if _is_coloured(pixels):
            return _luminance(name, pixels, _LUMINANCE)
        image = tiff_to_greyscale(data, name, page, pixels)
        return image[: parsed_info(parse_tiff(ExportedFile(0, name, data, "", 0, 0), page), NO_SCAN).height_px]
    pixels = png.read_pixels(data, name) if png.is_png(data) else _decode(data, name)
    if _is_coloured(pixels):
        return _luminance(name, pixels, _LUMINANCE[::-1])
    return greyscale.to_greyscale(name, pixels, tiff_pixels.Photometric.BLACK_IS_ZERO)


def _decode(data: bytes, name: str) -> NDArray[np.generic]:
    """Decode an image in any format that OpenCV reads, without rotation by metadata."""
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise BadImage(f"{name}: is neither TIFF nor PNG nor any other image that can be read; save it as TIFF.")
    return pixels


def _is_coloured(pixels: NDArray[np.generic]) -> bool:
    return pixels.ndim == 3 and pixels.shape[2] >= 3 and bool((pixels[..., :3] != pixels[..., :1]).any())


def _luminance(name: str, pixels: NDArray[np.generic], weights: tuple[float, ...]) -> Grey:
    if pixels.dtype not in (np.uint8, np.uint16):
        raise BadImage(f"{name}: has {pixels.dtype} pixels; save it with 8 or 16 bit.")
    colours = np.asarray(pixels[..., :3], dtype=np.float32)
    luminance = np.rint(colours @ np.array(weights, dtype=np.float32))
    return luminance.astype(np.uint8) if pixels.dtype == np.uint8 else luminance.astype(np.uint16)
