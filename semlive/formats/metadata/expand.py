"""Compressed chunks of a log, expanded up to a stated size.

131 kB of zstd can hold 4 GiB of zeros. What a chunk says of its own size is not believed: expanding ends at the bound.
"""

from __future__ import annotations

import lz4.frame
import zstandard

from semlive.errors import BadLog

MOST_EXPANDED_BYTES = 256 * 2**20
"""Size of an expanded chunk that is still read; writers of MCAP make chunks of about 1 MiB, or of one message."""
ANY_RATIO_BYTES = 32 * 2**20
"""Up to this size a chunk may be compressed by any factor."""
MOST_RATIO = 100
"""Factor by which a larger chunk may be compressed: telemetry as text reaches 10 to 30, images less than 5."""

_BLOCK_BYTES = 2**20


def expanded(compression: str, data: bytes) -> bytes:
    """The content of a compressed chunk.

    Args:
        compression: ``zstd`` or ``lz4``, as the chunk names it.
        data: as stored.

    Raises:
        BadLog: it expands to more than is read.
        ValueError: it is damaged, or the compression is unknown.
    """
    most = max(ANY_RATIO_BYTES, min(MOST_EXPANDED_BYTES, MOST_RATIO * len(data)))
    try:
        if compression == "zstd":
            return _zstd(data, most)
        if compression == "lz4":
            return _lz4(data, most)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f"damaged {compression} data: {error}") from error
    raise ValueError(f"unknown compression {compression}")


def _zstd(data: bytes, most: int) -> bytes:
    found = bytearray()
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        while block := reader.read(_BLOCK_BYTES):
            found += block
            _require_at_most(len(found), len(data), most)
    return bytes(found)


def _lz4(data: bytes, most: int) -> bytes:
    found, reader, rest = bytearray(), lz4.frame.LZ4FrameDecompressor(), data
    while not reader.eof:
        block = reader.decompress(rest, max_length=_BLOCK_BYTES)
        rest = b""
        if not block and reader.needs_input:
            raise ValueError("damaged lz4 data: it ends too early")
        found += block
        _require_at_most(len(found), len(data), most)
    return bytes(found)


def _require_at_most(size: int, stored: int, most: int) -> None:
    if size > most:
        raise BadLog(
            f"a chunk of {_size(stored)} expands to more than {_size(most)}, which no writer of logs makes; "
            "check where this log is from, and write it again with smaller chunks if it is sound."
        )


def _size(size: int) -> str:
    return f"{size / 2**20:.0f} MiB" if size >= 2**20 else f"{size / 1e3:.0f} kB"
