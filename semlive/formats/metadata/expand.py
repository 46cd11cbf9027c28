"""Expansion of compressed chunks of a log, up to a limit.

131 kB of zstd can contain 4 GiB of zeros. The size that a chunk states is not used: expansion ends at the limit.
"""

from __future__ import annotations

import lz4.frame
import zstandard

from semlive.errors import BadLog

MAX_EXPANDED_BYTES = 256 * 2**20
"""Largest size of an expanded chunk; writers of MCAP write chunks of about 1 MiB, or of one message."""
ANY_RATIO_BYTES = 32 * 2**20
"""Up to this size a chunk may be compressed by any factor."""
MAX_RATIO = 100
"""Factor by which a larger chunk may be compressed: telemetry as text reaches 10 to 30, images less than 5."""

_BLOCK_BYTES = 2**20


def expanded(compression: str, data: bytes) -> bytes:
    """Return the content of a compressed chunk.

    Args:
        compression: ``zstd`` or ``lz4``, as named in the chunk.
        data: compressed bytes.

    Raises:
        BadLog: the content exceeds the limit.
        ValueError: the data are damaged, or the compression is unknown.
    """
    limit = max(ANY_RATIO_BYTES, min(MAX_EXPANDED_BYTES, MAX_RATIO * len(data)))
    try:
        if compression == "zstd":
            return _zstd(data, limit)
        if compression == "lz4":
            return _lz4(data, limit)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f"damaged {compression} data: {error}") from error
    raise ValueError(f"unknown compression {compression}")


def _zstd(data: bytes, limit: int) -> bytes:
    content = bytearray()
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        while block := reader.read(_BLOCK_BYTES):
            content += block
            _check_size(len(content), len(data), limit)
    return bytes(content)


def _lz4(data: bytes, limit: int) -> bytes:
    content, reader, remaining = bytearray(), lz4.frame.LZ4FrameDecompressor(), data
    while not reader.eof:
        block = reader.decompress(remaining, max_length=_BLOCK_BYTES)
        remaining = b""
        if not block and reader.needs_input:
            raise ValueError("damaged lz4 data: it ends too early")
        content += block
        _check_size(len(content), len(data), limit)
    return bytes(content)


def _check_size(size: int, stored: int, limit: int) -> None:
    if size > limit:
        raise BadLog(
            f"a chunk of {_size(stored)} expands to more than {_size(limit)}, which no writer of logs makes; "
            "check where this log is from, and write it again with smaller chunks if it is sound."
        )


def _size(size: int) -> str:
    return f"{size / 2**20:.0f} MiB" if size >= 2**20 else f"{size / 1e3:.0f} kB"
