"""From the bytes of an exported file to a frame, whoever wrote it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.frame import ExportedFile, Frame, FrameInfo
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats import fei, grey, plain, png, tiff


def read_info(file: ExportedFile, profile: ScanProfile) -> FrameInfo:
    """What is known of a frame, from header and profile alone: no pixel is decoded.

    Args:
        file: the exported file.
        profile: what the user says of files whose vendor does not.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    data = file.data
    if tiff.is_tiff(data):
        directory = tiff.first_directory(data, file.name)
        width, rows = tiff.size_px(data, file.name, directory)
        header = fei.read_header(data, directory)
        if header is not None:
            return fei.frame_info(file, header, width, rows, profile)
        return plain.frame_info(file, width, rows, profile)
    if png.is_png(data):
        width, rows = png.size_px(data, file.name)
        return plain.frame_info(file, width, rows, profile)
    raise BadImage(f"{file.name}: is neither TIFF nor PNG; set the microscope's export to TIFF.")


def read_frame(file: ExportedFile, profile: ScanProfile) -> Frame:
    """A frame with its pixels, databar cropped, checked for being a finished scan.

    Args:
        file: the exported file.
        profile: what the user says of files whose vendor does not.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    info = read_info(file, profile)
    pixels = _pixels(file)
    # Whole rows from the top of a contiguous image are contiguous themselves.
    image: NDArray[np.uint8] | NDArray[np.uint16] = pixels[: info.height_px]
    grey.check_content(file.name, image)
    return Frame(info, image)


def check_complete(data: bytes) -> str | None:
    """What is missing of an image file, in words; None if it is whole (pixels are not decoded)."""
    if tiff.is_tiff(data):
        return tiff.check_complete(data)
    if png.is_png(data):
        return png.check_complete(data)
    return "it is neither TIFF nor PNG"


def _pixels(file: ExportedFile) -> NDArray[np.uint8] | NDArray[np.uint16]:
    if png.is_png(file.data):
        return grey.as_grey(file.name, png.read_pixels(file.data, file.name), tiff.Photometric.BLACK_IS_ZERO)
    directory = tiff.first_directory(file.data, file.name)
    pixels = tiff.read_pixels(file.data, file.name, directory)
    photometric = directory.integer(file.data, tiff.Tag.PHOTOMETRIC, tiff.Photometric.BLACK_IS_ZERO)
    return grey.as_grey(file.name, pixels, photometric, directory.integers(file.data, tiff.Tag.COLOR_MAP))
