"""TIFF files in the layouts of the vendors: directory before or after the pixels, private tags.

Layout: TIFF 6.0 specification, section 2; little endian.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from itertools import accumulate

from semlive_simulators.exporters.image_metadata import Pixels

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL = 1, 2, 3, 4, 5
Entry = tuple[int, int, int, bytes]
"""Tag, type, count, value."""

GREY_RAMP = tuple(257 * level for level in range(256)) * 3
"""A palette in which the index is the grey value, as in files of Zeiss and JEOL."""


def shorts(tag: int, *values: int) -> Entry:
    """A tag of 16-bit numbers."""
    return tag, _SHORT, len(values), struct.pack(f"<{len(values)}H", *values)


def longs(tag: int, *values: int) -> Entry:
    """A tag of 32-bit numbers."""
    return tag, _LONG, len(values), struct.pack(f"<{len(values)}I", *values)


def rational(tag: int, numerator: int, denominator: int) -> Entry:
    """A tag of one fraction."""
    return tag, _RATIONAL, 1, struct.pack("<II", numerator, denominator)


def text(tag: int, value: str, encoding: str = "ascii") -> Entry:
    """A tag of text, closed by a NUL."""
    data = value.encode(encoding) + b"\0"
    return tag, _ASCII, len(data), data


def raw_bytes(tag: int, data: bytes) -> Entry:
    """A tag of bytes."""
    return tag, _BYTE, len(data), data


def row_strips(pixels: Pixels, rows: int) -> list[bytes]:
    """Uncompressed strips of a number of rows."""
    return [pixels[first : first + rows].astype(pixels.dtype.newbyteorder("<")).tobytes() for first in range(0, pixels.shape[0], rows)]


def file_bytes(strips: Sequence[bytes], entries: Sequence[Entry], *, directory_first: bool) -> bytes:
    """A complete file with one image.

    Args:
        strips: the pixel data as stored.
        entries: all tags but strip offsets and strip lengths, which are added here.
        directory_first: whether the directory is before the pixels (Zeiss), or after them (FEI, TESCAN, JEOL).
    """
    lengths = [len(strip) for strip in strips]
    pixel_bytes = sum(lengths) + sum(lengths) % 2
    sized = sorted([*entries, longs(279, *lengths), longs(273, *lengths)])
    directory_bytes = 2 + 12 * len(sized) + 4 + sum(len(data) + len(data) % 2 for *_, data in sized if len(data) > 4)
    first_pixel = 8 + directory_bytes if directory_first else 8
    directory_at = 8 if directory_first else 8 + pixel_bytes
    offsets = [first_pixel + before for before in accumulate(lengths[:-1], initial=0)]
    sized = [longs(273, *offsets) if entry[0] == 273 else entry for entry in sized]
    directory = _directory(sized, directory_at)
    pixels = b"".join(strips).ljust(pixel_bytes, b"\0")
    head = struct.pack("<2sHI", b"II", 42, directory_at)
    return head + (directory + pixels if directory_first else pixels + directory)


def _directory(entries: Sequence[Entry], at: int) -> bytes:
    place = at + 2 + 12 * len(entries) + 4
    directory, values = bytearray(struct.pack("<H", len(entries))), bytearray()
    for tag, kind, count, data in entries:
        if len(data) <= 4:
            directory += struct.pack("<HHI4s", tag, kind, count, data.ljust(4, b"\0"))
            continue
        directory += struct.pack("<HHII", tag, kind, count, place + len(values))
        values += data + b"\0" * (len(data) % 2)
    return bytes(directory) + struct.pack("<I", 0) + bytes(values)
