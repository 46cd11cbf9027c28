"""TIFF: completeness, tags and pixels of a file.

This module reads the directory itself, without decoding, because completeness is a property of byte ranges. SEM programs write the
directory first (Zeiss) or last (FEI, TESCAN, JEOL), and an FEI file cut at 99.99 % of its length decodes bit-exactly without
metadata, because the value of their tag is behind the pixels. Pixels are decoded by tifffile, or by OpenCV if compressed.
Layout: TIFF 6.0 specification, sections 2 and 8; BigTIFF as written by libtiff.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from io import BytesIO

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from semlive.errors import BadImage

MAX_SIDE_PX = 20_000
MAX_IMAGE_BYTES = 512 * 2**20
_MAX_INFLATION = 200
_MAX_TAGS = 4096
_MAX_PAGES = 64
_LONG_VALUE = 64
_ZEROS = 16  # more NUL bytes than end a text: one, in real files up to five
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_INTEGER_FORMATS = {1: "u1", 3: "u2", 4: "u4", 13: "u4", 16: "u8", 18: "u8"}


class Tag(IntEnum):
    """Tags that this module or a vendor module reads."""

    WIDTH = 256
    HEIGHT = 257
    BITS_PER_SAMPLE = 258
    COMPRESSION = 259
    PHOTOMETRIC = 262
    STRIP_OFFSETS = 273
    SAMPLES_PER_PIXEL = 277
    ROWS_PER_STRIP = 278
    STRIP_BYTES = 279
    COLOR_MAP = 320
    TILE_OFFSETS = 324
    TILE_BYTES = 325
    SAMPLE_FORMAT = 339
    ZEISS = 34118
    FEI_SFEG = 34680
    FEI_HELIOS = 34682
    FEI_XML = 34683
    TESCAN = 50431


class Photometric(IntEnum):
    """Meaning of the numbers of a pixel."""

    WHITE_IS_ZERO = 0
    BLACK_IS_ZERO = 1
    RGB = 2
    PALETTE = 3


@dataclass(frozen=True, slots=True)
class TagEntry:
    """One tag: its value has `nbytes` bytes from `offset` of the file."""

    kind: int
    count: int
    offset: int
    nbytes: int


@dataclass(frozen=True, slots=True)
class Directory:
    """One image file directory.

    Attributes:
        order: ``<`` or ``>``.
        tags: the tags by code.
        next_offset: offset of the next directory; 0 if there is none.
    """

    order: str
    tags: dict[int, TagEntry]
    next_offset: int

    def raw(self, data: bytes, code: int) -> bytes | None:
        """Return the value of a tag as bytes; None if the tag is absent or its value is not inside the file."""
        tag = self.tags.get(code)
        if tag is None or tag.offset + tag.nbytes > len(data):
            return None
        return data[tag.offset : tag.offset + tag.nbytes]

    def text(self, data: bytes, code: int) -> str | None:
        """Return the value of a tag as text up to its first NUL, or None."""
        raw = self.raw(data, code)
        return None if raw is None else raw.split(b"\0", 1)[0].decode("utf-8", errors="replace")

    def integers(self, data: bytes, code: int) -> list[int]:
        """Return the value of a tag as integers; empty if the tag is absent, not of an integer type, or outside the file."""
        raw = self.raw(data, code)
        kind = _INTEGER_FORMATS.get(self.tags[code].kind) if raw is not None else None
        if raw is None or kind is None:
            return []
        return [int(number) for number in np.frombuffer(raw, self.order + kind)]

    def integer(self, data: bytes, code: int, default: int) -> int:
        """Return the first integer of the value of a tag."""
        numbers = self.integers(data, code)
        return numbers[0] if numbers else default


def is_tiff(data: bytes) -> bool:
    """Whether the file has the signature of TIFF or BigTIFF."""
    return data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def first_directory(data: bytes, name: str) -> Directory:
    """Return the directory of the first image.

    Raises:
        BadImage: there is none, or it is truncated.
    """
    try:
        return _directory(data, *_first_offset(data))
    except (struct.error, ValueError) as exc:
        raise BadImage(f"{name}: not a complete TIFF file ({exc}); export it again.") from exc


def check_complete(data: bytes) -> str | None:
    """Return what is missing of a TIFF file, a clause; None if the values of all tags and all strips are inside it."""
    try:
        order, big, offset = _first_offset(data)
        visited: set[int] = set()
        while offset and len(visited) < _MAX_PAGES:
            if offset in visited:
                return "its directories form a loop"
            visited.add(offset)
            directory = _directory(data, order, big, offset)
            missing = _missing(data, directory)
            if missing is not None:
                return missing
            offset = directory.next_offset
    except (struct.error, ValueError) as exc:
        return str(exc)
    return None


def size_px(data: bytes, name: str, directory: Directory) -> tuple[int, int]:
    """Return width and height, checked against the largest scan.

    Raises:
        BadImage: they are missing, or too large to be plausible.
    """
    width = directory.integer(data, Tag.WIDTH, 0)
    height = directory.integer(data, Tag.HEIGHT, 0)
    check_size(name, width, height, max(directory.integer(data, Tag.SAMPLES_PER_PIXEL, 1), 1))
    return width, height


def check_size(name: str, width: int, height: int, samples: int) -> None:
    """Refuse images that would exhaust the memory.

    Raises:
        BadImage: no pixels, a side of more than MAX_SIDE_PX, or more than MAX_IMAGE_BYTES at 16 bit.
    """
    if width < 1 or height < 1:
        raise BadImage(f"{name}: states a size of {width} x {height} px; export it again.")
    if width > MAX_SIDE_PX or height > MAX_SIDE_PX or width * height * samples * 2 > MAX_IMAGE_BYTES:
        raise BadImage(f"{name}: states a size of {width} x {height} px with {samples} samples, more than is read; export a smaller frame.")


def check_inflation(name: str, pixel_bytes: int, file_bytes: int, compressed: bool) -> None:
    """Refuse files that would expand to more than a scan can: noise compresses two- or threefold, never a hundredfold.

    Raises:
        BadImage: the file is too small for its stated size.
    """
    if pixel_bytes > file_bytes * (_MAX_INFLATION if compressed else 1):
        raise BadImage(f"{name}: states {pixel_bytes} bytes of pixels in a file of {file_bytes} bytes; export it again.")


def zero_rows(data: bytes, directory: Directory, last_row: int) -> int:
    """Count the rows of zero bytes upwards from `last_row`; 0 if the pixels are compressed or in tiles.

    A preallocated file whose directory comes first decodes without error before its pixels are written: they are zeros.
    """
    compressed = directory.integer(data, Tag.COMPRESSION, 1) != 1
    offsets, height = directory.integers(data, Tag.STRIP_OFFSETS), directory.integer(data, Tag.HEIGHT, 0)
    lengths = directory.integers(data, Tag.STRIP_BYTES)
    in_strip = min(directory.integer(data, Tag.ROWS_PER_STRIP, height), height)
    if compressed or in_strip < 1 or len(offsets) != len(lengths) or len(offsets) != -(-height // in_strip) or last_row > height:
        return 0
    for row in range(last_row - 1, -1, -1):
        strip, at = divmod(row, in_strip)
        rows = min(in_strip, height - strip * in_strip)
        width_bytes = lengths[strip] // rows
        first = offsets[strip] + at * width_bytes
        if width_bytes < 1 or data.count(0, first, first + width_bytes) != width_bytes:
            return last_row - 1 - row
    return last_row


def ends_in_zeros(data: bytes) -> bool:
    """Whether the file, or the long value of a tag, ends in more zeros than end a text: its content may not be written yet."""
    try:
        directory = _directory(data, *_first_offset(data))
    except (struct.error, ValueError):
        return False
    values = [tag for tag in directory.tags.values() if tag.nbytes >= _LONG_VALUE]
    ends = [len(data), *(tag.offset + tag.nbytes for tag in values)]
    return any(data[end - _ZEROS : end] == bytes(_ZEROS) for end in ends if _ZEROS <= end <= len(data))


def read_pixels(data: bytes, name: str, directory: Directory) -> NDArray[np.generic]:
    """Return the pixels of the first image as stored: (height, width) or (height, width, samples).

    Raises:
        BadImage: the file is incomplete, or its pixels cannot be decoded.
    """
    width, height = size_px(data, name, directory)
    missing = check_complete(data)
    if missing is not None:
        raise BadImage(f"{name}: not a complete TIFF file ({missing}); export it again.")
    compression = directory.integer(data, Tag.COMPRESSION, 1)
    bits = _check_samples(data, name, directory)
    samples = max(directory.integer(data, Tag.SAMPLES_PER_PIXEL, 1), 1)
    check_inflation(name, width * height * samples * bits // 8, len(data), compressed=compression != 1)
    try:
        pixels = _read_plain(data, name, directory) if compression == 1 else _read_compressed(data)
    except BadImage:
        raise
    except Exception as exc:  # tifffile raises many types of errors on damaged files
        reason = (str(exc).splitlines() or [type(exc).__name__])[0]
        raise BadImage(f"{name}: its pixels cannot be decoded ({reason}); export it again.") from exc
    if pixels.shape[:2] != (height, width):
        raise BadImage(f"{name}: decodes to {pixels.shape[:2]}, but its tags state {(height, width)}; export it again.")
    return pixels


def _check_samples(data: bytes, name: str, directory: Directory) -> int:
    bits = set(directory.integers(data, Tag.BITS_PER_SAMPLE)) or {1}
    formats = set(directory.integers(data, Tag.SAMPLE_FORMAT)) or {1}
    if bits not in ({8}, {16}) or formats != {1}:
        raise BadImage(f"{name}: has samples of {sorted(bits)} bit (format {sorted(formats)}); export 8 or 16 bit grey.")
    return bits.pop()


def _read_plain(data: bytes, name: str, directory: Directory) -> NDArray[np.generic]:
    with tifffile.TiffFile(BytesIO(data)) as tiff:
        page = tiff.pages[0]
        # tifffile applies special rules to some vendors, so the size that it will allocate is checked again.
        if math.prod(page.shape) > len(data) or len(page.shape) not in (2, 3):
            raise BadImage(f"{name}: is a stack of shape {page.shape}; export single frames.")
        pixels = page.asarray(maxworkers=1)
    if pixels.ndim == 3 and pixels.shape[0] == directory.integer(data, Tag.SAMPLES_PER_PIXEL, 1) != pixels.shape[2]:
        pixels = np.moveaxis(pixels, 0, 2)
    return pixels


def _read_compressed(data: bytes) -> NDArray[np.generic]:
    # libtiff, inside OpenCV, decodes strip by strip into a buffer of known size, so the memory for a small file is bounded.
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("unknown compression")
    return pixels


def _first_offset(data: bytes) -> tuple[str, bool, int]:
    if not is_tiff(data):
        raise ValueError("it does not start with a TIFF header")
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    [offset] = struct.unpack_from(order + "Q", data, 8) if big else struct.unpack_from(order + "I", data, 4)
    if offset == 0:
        raise ValueError("it has no directory")
    return order, big, offset


def _directory(data: bytes, order: str, big: bool, offset: int) -> Directory:
    head, entry, inline = ("Q", "HHQQ", 8) if big else ("H", "HHII", 4)
    head_bytes, entry_bytes = struct.calcsize(order + head), struct.calcsize(order + entry)
    pointer = "Q" if big else "I"
    if offset + head_bytes > len(data):
        raise ValueError(f"its directory would begin at byte {offset} of {len(data)}")
    [count] = struct.unpack_from(order + head, data, offset)
    end = offset + head_bytes + count * entry_bytes
    if count > _MAX_TAGS or end + struct.calcsize(order + pointer) > len(data):
        raise ValueError(f"its directory of {count} tags does not end inside the file")
    tags: dict[int, TagEntry] = {}
    for at in range(offset + head_bytes, end, entry_bytes):
        code, kind, number, value = struct.unpack_from(order + entry, data, at)
        nbytes = number * _TYPE_BYTES.get(kind, 0)
        tags[code] = TagEntry(kind, number, at + entry_bytes - inline if nbytes <= inline else value, nbytes)
    [following] = struct.unpack_from(order + pointer, data, end)
    return Directory(order, tags, following)


def _missing(data: bytes, directory: Directory) -> str | None:
    for code, tag in directory.tags.items():
        if tag.offset + tag.nbytes > len(data):
            return f"the value of tag {code} would end at byte {tag.offset + tag.nbytes} of {len(data)}"
    tiled = Tag.TILE_OFFSETS in directory.tags
    offsets = np.array(directory.integers(data, Tag.TILE_OFFSETS if tiled else Tag.STRIP_OFFSETS), dtype=np.float64)
    counts = np.array(directory.integers(data, Tag.TILE_BYTES if tiled else Tag.STRIP_BYTES), dtype=np.float64)
    if offsets.size == 0 or offsets.size != counts.size:
        return f"it has {offsets.size} strip offsets and {counts.size} strip lengths"
    end = float(np.max(offsets + counts))
    if end > len(data):
        return f"its pixels would end at byte {end:.0f} of {len(data)}"
    return None
