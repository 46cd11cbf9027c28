"""Proof by its bytes alone that an image file is complete, so that nothing need be awaited.

A PNG has a checksum over every byte. An uncompressed TIFF has none, but every part of the file system's space that is not written yet reads
as zeros; SEM images have noise, so rows without long runs of zeros are written. Dark or saturated images, compressed
strips and tiles have no proof, although they may be complete: such a file must be constant for some time instead.
"""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.formats.images.frames import parse_file
from semlive.formats.metadata.checksum import crc32
from semlive.formats.metadata.header import Header
from semlive.formats.vendors import tiff

_MAX_ZERO_BYTES = 256
"""Longest run of zeros in written pixels; 95 in a dark frame of a real microscope. File systems allocate in blocks of 512 bytes or more."""
_MAX_ZERO_TEXT_BYTES = 16
"""Longest run of zeros in the value of a tag; real texts end in up to five."""
_INLINE_BYTES = 8


@dataclass(frozen=True, slots=True)
class CompletenessProof:
    """Result for a file whose bytes prove that it is complete.

    Attributes:
        vendor: vendor of the header inside the image file; ``plain`` without one, which a program may still append.
        row_checksums: checksum of every row above the databar; empty where the file has checksums of its own. Two scans have no row in
            common, so a common row is that of an older file which is being overwritten in place.
    """

    vendor: str
    row_checksums: tuple[int, ...] = ()

    def shares_rows(self, other: CompletenessProof) -> bool:
        """Whether any row is equal to the same row of another file."""
        return any(mine == theirs for mine, theirs in zip(self.row_checksums, other.row_checksums, strict=False))


def prove_complete(file: ExportedFile, profile: ScanProfile) -> CompletenessProof | None:
    """Return the proof that every byte of a file is written, or None if its bytes do not prove that.

    Args:
        file: a file without sidecar that `check_complete` and `check_finished` accept.
        profile: number of databar rows for files that do not contain it.

    Raises:
        BadImage: the file has no readable header.
    """
    parsed = parse_file(file, profile.page)
    header = parsed.header
    if parsed.page is None:
        return CompletenessProof(header.vendor)
    # The rows of one image prove nothing about the others of a file.
    if len(tiff.directories(file.data, file.name)) > 1:
        return None
    directory = parsed.page.directory
    if tiff.ends_in_zeros(file.data) or _has_unwritten_tag(file.data, directory):
        return None
    rows = _stored_rows(file.data, directory, image_rows(header, parsed.rows, profile))
    pixels = b"".join(rows)
    if not rows or bytes(min(len(rows[0]), _MAX_ZERO_BYTES)) in pixels:
        return None
    return CompletenessProof(header.vendor, tuple(crc32(row) for row in rows))


def image_rows(header: Header, rows: int, profile: ScanProfile) -> int:
    """Return the number of rows above the databar of an image with `rows` rows."""
    return int(header.height_px) if header.height_px else rows - int(header.databar_rows or profile.databar_rows or 0)


def _has_unwritten_tag(data: bytes, directory: tiff.Directory) -> bool:
    """Whether an entry of the directory is zero, or more of the value of a tag than texts and numbers contain."""
    for tag in directory.tags.values():
        hole = bytes(min(tag.nbytes, _MAX_ZERO_TEXT_BYTES))
        if tag.kind == 0 or (tag.nbytes > _INLINE_BYTES and hole in data[tag.offset : tag.offset + tag.nbytes]):
            return True
    return False


def _stored_rows(data: bytes, directory: tiff.Directory, last_row: int) -> list[bytes]:
    """Return the bytes of the first `last_row` rows; empty if the pixels are compressed, in tiles or in strips of unequal rows."""
    offsets, lengths = directory.integers(data, tiff.Tag.STRIP_OFFSETS), directory.integers(data, tiff.Tag.STRIP_BYTES)
    height = directory.integer(data, tiff.Tag.HEIGHT, 0)
    in_strip = min(directory.integer(data, tiff.Tag.ROWS_PER_STRIP, height), height)
    is_plain = directory.integer(data, tiff.Tag.COMPRESSION, 1) == 1 and in_strip > 0 and 0 < last_row <= height
    if not is_plain or not len(offsets) == len(lengths) == -(-height // in_strip):
        return []
    rows: list[bytes] = []
    for strip, (offset, length) in enumerate(zip(offsets, lengths, strict=True)):
        count = min(in_strip, height - strip * in_strip)
        width_bytes, rest = divmod(length, count)
        if rest or not width_bytes or offset + length > len(data):
            return []
        rows += [data[at : at + width_bytes] for at in range(offset, offset + length, width_bytes)]
    return rows[:last_row]
