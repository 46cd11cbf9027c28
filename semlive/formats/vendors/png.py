"""PNG: completeness, size and pixels of a file."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadImage
from semlive.formats.vendors.image_size import check_inflation, check_size

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def is_png(data: bytes) -> bool:
    """Whether the file starts as a PNG does."""
    return data[:8] == _SIGNATURE


def check_complete(data: bytes) -> str | None:
    """Return what is missing of a PNG file, a clause; None if complete chunks extend to an empty IEND chunk inside the file.

    Lengths are checked here because libpng allocates memory for a chunk before it reads it: 1.2 GB for an 860 byte file, measured.
    """
    at = len(_SIGNATURE)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            break
        if struct.unpack_from(">I", data, end)[0] != zlib.crc32(memoryview(data)[at + 4 : end]):
            return f"the checksum of its chunk at byte {at} is wrong"
        if kind == b"IEND":
            return None if length == 0 else "its IEND chunk is not empty"
        at = end + 4
    return f"it ends at byte {len(data)} before its IEND chunk"


def size_px(data: bytes, name: str) -> tuple[int, int]:
    """Return width and height from the header.

    Raises:
        BadImage: there is no header, or the size is not plausible.
    """
    if data[12:16] != b"IHDR" or len(data) < 33:
        raise BadImage(f"{name}: not a complete PNG file (no header); export it again.")
    width, height = struct.unpack_from(">II", data, 16)
    check_size(name, width, height, 1)
    return width, height


def read_pixels(data: bytes, name: str) -> NDArray[np.generic]:
    """Return pixels as stored: (height, width) or (height, width, samples).

    Raises:
        BadImage: the file is incomplete, or its pixels cannot be decoded.
    """
    import cv2  # noqa: PLC0415  (the control process reads headers and decodes no image)

    width, height = size_px(data, name)
    missing = check_complete(data)
    if missing is not None:
        raise BadImage(f"{name}: not a complete PNG file ({missing}); export it again.")
    check_inflation(name, width * height, len(data), compressed=True)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as exc:
        raise BadImage(f"{name}: its pixels cannot be decoded; export it again.") from exc
    if pixels is None or pixels.shape[:2] != (height, width):
        raise BadImage(f"{name}: its pixels cannot be decoded; export it again.")
    return pixels
