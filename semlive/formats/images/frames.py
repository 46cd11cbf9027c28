"""From the bytes of an exported file to a frame, whoever wrote it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.frame import ExportedFile, Frame, FrameInfo
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images import frame_metadata
from semlive.formats.metadata.header import Header
from semlive.formats.vendors import fei, greyscale, hitachi, jeol, plain, png, tescan, tiff, zeiss

SIDECAR_VENDORS = ("jeol", "hitachi")
"""Vendors whose header is always a text file beside the image."""


def read_header(file: ExportedFile) -> tuple[Header, int, int]:
    """What the file itself says: its header, its width and its rows, databar included. Nothing is filled in.

    A header inside the image comes before one beside it.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    data = file.data
    if tiff.is_tiff(data):
        directory = tiff.first_directory(data, file.name)
        width, rows = tiff.size_px(data, file.name, directory)
        header = fei.read_header(data, directory) or zeiss.read_header(data, directory, width, rows) or tescan.read_header(data, directory)
    elif png.is_png(data):
        width, rows = png.size_px(data, file.name)
        header = None
    else:
        raise BadImage(f"{file.name}: is neither TIFF nor PNG; set the microscope's export to TIFF.")
    return header or read_sidecar(file.sidecar or b"", file.mtime_ns) or plain.header(), width, rows


def read_sidecar(sidecar: bytes, mtime_ns: int) -> Header | None:
    """What the text file beside an image says; None if no vendor writes such a file."""
    return jeol.read_sidecar(sidecar) or tescan.read_sidecar(sidecar) or hitachi.read_sidecar(sidecar, mtime_ns)


def read_info(file: ExportedFile, profile: ScanProfile) -> FrameInfo:
    """What is known of a frame, from header and profile alone: no pixel is decoded.

    Args:
        file: the exported file.
        profile: what the user says of files whose vendor does not.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    header, width, rows = read_header(file)
    return frame_metadata.frame_info(file, header, width, rows, profile)


def read_frame(file: ExportedFile, profile: ScanProfile) -> Frame:
    """A frame with its pixels, databar cropped, checked for being a finished scan.

    Args:
        file: the exported file.
        profile: what the user says of files whose vendor does not.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    info = read_info(file, profile)
    pixels = read_pixels(file)
    # Whole rows from the top of a contiguous image are contiguous themselves.
    image: NDArray[np.uint8] | NDArray[np.uint16] = pixels[: info.height_px]
    greyscale.check_content(file.name, image)
    return Frame(info, image)


def check_complete(data: bytes) -> str | None:
    """What is missing of an image file, in words; None if it is whole (pixels are not decoded)."""
    if tiff.is_tiff(data):
        return tiff.check_complete(data)
    if png.is_png(data):
        return png.check_complete(data)
    return "it is neither TIFF nor PNG"


def check_finished(file: ExportedFile, profile: ScanProfile, vendor: str | None = None) -> str | None:
    """What a file that is whole in structure still lacks, in words: its vendor's header, its sidecar's agreement, its last rows.

    Args:
        file: the file, with its sidecar if there is one.
        profile: tells how many rows are databar, where the file does not.
        vendor: whose header it must have; None if any will do.
    """
    try:
        header, width, rows = read_header(file)
    except BadImage as error:
        return str(error).removeprefix(f"{file.name}: ").rstrip(".")
    if vendor is not None and header.vendor != vendor:
        return f"it has no header of {vendor}" + (" beside it" if vendor in SIDECAR_VENDORS else "")
    if header.width_px not in (None, width) or header.rows not in (None, rows):
        return f"it is {width} x {rows} px, its header speaks of another image"
    if not tiff.is_tiff(file.data):
        return None
    bar = rows - int(header.height_px) if header.height_px else header.databar_rows or profile.databar_rows or 0
    zeros = tiff.zero_rows(file.data, tiff.first_directory(file.data, file.name), rows - bar)
    return f"its last {zeros} rows are zero" if zeros >= 2 else None


def ends_like_partial_file(data: bytes) -> bool:
    """Whether a file that seems whole ends as one that is still being filled does; some programs end texts so, too."""
    return tiff.is_tiff(data) and tiff.ends_in_zeros(data)


def read_pixels(file: ExportedFile) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """All pixels as one grey channel, databar included.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    if png.is_png(file.data):
        return greyscale.to_greyscale(file.name, png.read_pixels(file.data, file.name), tiff.Photometric.BLACK_IS_ZERO)
    directory = tiff.first_directory(file.data, file.name)
    pixels = tiff.read_pixels(file.data, file.name, directory)
    photometric = directory.integer(file.data, tiff.Tag.PHOTOMETRIC, tiff.Photometric.BLACK_IS_ZERO)
    return greyscale.to_greyscale(file.name, pixels, photometric, directory.integers(file.data, tiff.Tag.COLOR_MAP))
