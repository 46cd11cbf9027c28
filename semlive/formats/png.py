"""PNG: is the file whole, how large is it, and what are its pixels."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadImage
from semlive.formats.tiff import check_inflation, check_size

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def is_png(data: bytes) -> bool:
    """Whether the file starts as a PNG does."""
    return data[:8] == _SIGNATURE


def check_complete(data: bytes) -> str | None:
    """What is missing of a PNG file, in words; None if its chunks run to the IEND chunk inside the file."""
    at = len(_SIGNATURE)
    while at + 12 <= len(data):
        [length] = struct.unpack_from(">I", data, at)
        if data[at + 4 : at + 8] == b"IEND":
            return None
        at += 12 + length
    return f"it ends at byte {len(data)} before its IEND chunk"


def size_px(data: bytes, name: str) -> tuple[int, int]:
    """Width and height from the header.

    Raises:
        BadImage: no header, or a size that cannot be believed.
    """
    if data[12:16] != b"IHDR" or len(data) < 33:
        raise BadImage(f"{name}: not a whole PNG file (no header); export it again.")
    width, height = struct.unpack_from(">II", data, 16)
    check_size(name, width, height, 1)
    return width, height


def read_pixels(data: bytes, name: str) -> NDArray[np.generic]:
    """Pixels as stored: (height, width) or (height, width, samples).

    Raises:
        BadImage: the file is not whole, or its pixels cannot be decoded.
    """
    width, height = size_px(data, name)
    missing = check_complete(data)
    if missing is not None:
        raise BadImage(f"{name}: not a whole PNG file ({missing}); export it again.")
    check_inflation(name, width * height, len(data), compressed=True)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as exc:
        raise BadImage(f"{name}: its pixels cannot be decoded; export it again.") from exc
    if pixels is None or pixels.shape[:2] != (height, width):
        raise BadImage(f"{name}: its pixels cannot be decoded; export it again.")
    return pixels
