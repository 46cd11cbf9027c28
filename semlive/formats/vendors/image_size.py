"""Limits of the size of an image, so that no file exhausts the memory.

A frame needs its file, its decoded pixels (at most MAX_IMAGE_BYTES) and, for compressed TIFF, one decoded strip or tile.
"""

from __future__ import annotations

from semlive.errors import BadImage

MAX_SIDE_PX = 20_000
MAX_IMAGE_BYTES = 512 * 2**20
_MAX_INFLATION = 200


def check_size(name: str, width: int, height: int, samples: int, sample_bytes: int = 2) -> None:
    """Refuse images that would exhaust the memory.

    Raises:
        BadImage: no pixels, a side of more than MAX_SIDE_PX, or more than MAX_IMAGE_BYTES.
    """
    if width < 1 or height < 1:
        raise BadImage(f"{name}: states a size of {width} x {height} px; export it again.")
    if width > MAX_SIDE_PX or height > MAX_SIDE_PX or width * height * samples * sample_bytes > MAX_IMAGE_BYTES:
        raise BadImage(f"{name}: states a size of {width} x {height} px with {samples} samples, more than is read; export a smaller frame.")


def check_inflation(name: str, pixel_bytes: int, file_bytes: int, compressed: bool) -> None:
    """Refuse files that would expand to more than a scan can: noise compresses two- or threefold, never a hundredfold.

    Raises:
        BadImage: the file is too small for its stated size.
    """
    if pixel_bytes > file_bytes * (_MAX_INFLATION if compressed else 1):
        raise BadImage(f"{name}: states {pixel_bytes} bytes of pixels in a file of {file_bytes} bytes; export it again.")
