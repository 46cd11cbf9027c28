"""TIFF: completeness and tags of a file; no pixel is decoded here (`semlive.formats.vendors.tiff_pixels`).

This module reads directories itself because completeness is a property of byte ranges. SEM programs write the directory first (Zeiss)
or last (FEI, TESCAN, JEOL), and an FEI file cut at 99.99 % of its length decodes bit-exactly without metadata, because the value of
their tag is behind the pixels. Layout: TIFF 6.0 specification, sections 2 and 8; BigTIFF as written by libtiff.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from semlive.errors import BadImage

_MAX_TAGS = 4096
_MAX_PAGES = 64
_BIG = (b"+\0", b"\0+")
_LONG_VALUE = 64
_ZEROS = 16  # more NUL bytes than end a text: one, in real files up to five
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_INTEGER_CODES = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
_INTEGER_FORMATS = {1: "u1", 3: "u2", 4: "u4", 13: "u4", 16: "u8", 18: "u8"}


class Tag(IntEnum):
    """Tags that this module or a vendor module reads."""

    SUBFILE_TYPE = 254
    OLD_SUBFILE_TYPE = 255
    WIDTH = 256
    HEIGHT = 257
    BITS_PER_SAMPLE = 258
    COMPRESSION = 259
    PHOTOMETRIC = 262
    DESCRIPTION = 270
    STRIP_OFFSETS = 273
    ORIENTATION = 274
    SAMPLES_PER_PIXEL = 277
    ROWS_PER_STRIP = 278
    STRIP_BYTES = 279
    PREDICTOR = 317
    COLOR_MAP = 320
    TILE_OFFSETS = 324
    TILE_BYTES = 325
    SUB_DIRECTORIES = 330
    EXTRA_SAMPLES = 338
    SAMPLE_FORMAT = 339
    ZEISS = 34118
    FEI_SFEG = 34680
    FEI_HELIOS = 34682
    FEI_XML = 34683
    TESCAN = 50431


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
        if raw is None:
            return None
        if raw[1:4:2] == b"\0\0" and raw[:1] != b"\0":  # UTF-16, which no standard permits
            return raw.decode("utf-16-le", errors="replace").lstrip("\ufeff").split("\0", 1)[0]
        return raw.split(b"\0", 1)[0].decode("utf-8", errors="replace")

    def integers(self, data: bytes, code: int) -> list[int]:
        """Return the value of a tag as integers; empty if the tag is absent, not of an integer type, or outside the file."""
        raw = self.raw(data, code)
        kind = _INTEGER_FORMATS.get(self.tags[code].kind) if raw is not None else None
        if raw is None or kind is None:
            return []
        return np.frombuffer(raw, self.order + kind).tolist()

    def integer(self, data: bytes, code: int, default: int) -> int:
        """Return the first integer of the value of a tag."""
        tag = self.tags.get(code)
        kind = None if tag is None else _INTEGER_CODES.get(tag.kind)
        if tag is None or kind is None or tag.count < 1 or tag.offset + tag.nbytes > len(data):
            return default
        return struct.unpack_from(self.order + kind, data, tag.offset)[0]


def is_tiff(data: bytes) -> bool:
    """Whether the file has the signature of TIFF or BigTIFF."""
    return data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def directories(data: bytes, name: str) -> list[Directory]:
    """Return the directories of all images, as far as they can be read.

    Raises:
        BadImage: the first is missing or truncated.
    """
    found: list[Directory] = []
    try:
        for directory in _walk(data):
            found.append(directory)
    except (struct.error, ValueError) as exc:
        if not found:
            raise BadImage(f"{name}: not a complete TIFF file ({exc}); export it again.") from exc
    return found


def sub_directories(data: bytes, directory: Directory) -> list[Directory]:
    """Return the directories below a directory (SubIFDs), as far as they can be read."""
    found: list[Directory] = []
    for offset in directory.integers(data, Tag.SUB_DIRECTORIES)[:_MAX_PAGES]:
        try:
            found.append(_directory(data, directory.order, data[2:4] in _BIG, offset))
        except (struct.error, ValueError):
            continue
    return found


def check_complete(data: bytes) -> str | None:
    """Return what is missing of a TIFF file, a clause; None if the values of all tags and all strips are inside it."""
    try:
        return next(filter(None, (_missing(data, directory) for directory in _walk(data))), None)
    except (struct.error, ValueError) as exc:
        return str(exc)


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
        directory = next(_walk(data))
    except (struct.error, ValueError):
        return False
    values = [tag for tag in directory.tags.values() if tag.nbytes >= _LONG_VALUE]
    ends = [len(data), *(tag.offset + tag.nbytes for tag in values)]
    return any(data[end - _ZEROS : end] == bytes(_ZEROS) for end in ends if _ZEROS <= end <= len(data))


def _walk(data: bytes) -> Iterator[Directory]:
    """Yield the directories in their order; at least one, at most 64 (a frame with its copies has two or three)."""
    order, big, offset = _first_offset(data)
    visited: set[int] = set()
    while offset and len(visited) < _MAX_PAGES:
        if offset in visited:
            raise ValueError("its directories form a loop")
        visited.add(offset)
        directory = _directory(data, order, big, offset)
        yield directory
        offset = directory.next_offset


def _first_offset(data: bytes) -> tuple[str, bool, int]:
    if not is_tiff(data):
        raise ValueError("it does not start with a TIFF header")
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4] in _BIG
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
    empty = int(np.count_nonzero((counts == 0) | (offsets == 0)))
    if empty:
        return f"{empty} of its {offsets.size} strips or tiles are not written"
    end = float(np.max(offsets + counts))
    if end > len(data):
        return f"its pixels would end at byte {end:.0f} of {len(data)}"
    return None
