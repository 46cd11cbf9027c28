"""Return of free memory to the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable

_ARENA_MAX, _MMAP_THRESHOLD, _TRIM_THRESHOLD = -8, -3, -1  # M_ARENA_MAX, M_MMAP_THRESHOLD and M_TRIM_THRESHOLD of malloc.h
_LARGE_BYTES = 128 << 10
_MATRIX_BYTES, _FREE_HEAP_BYTES = 4 << 20, 64 << 20


def _of_glibc(name: str) -> Callable[..., int] | None:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


_TRIM, _OPTION = _of_glibc("malloc_trim"), _of_glibc("mallopt")


def trim_heap() -> None:
    """Return free memory between used blocks to the system; without effect if the C library is not glibc.

    By default glibc returns only the free memory at the end of its heap: after a hyperparameter selection 190 of 360 MB stayed unused.
    """
    if _TRIM is not None:
        _TRIM(0)


def single_arena_small_blocks() -> None:
    """Use one heap for all threads, and separate memory for blocks above 128 kB; to be called before threads are started.

    With a heap for each of the twelve threads of control, partly used pages were returned in none of them. Once a block of some MB is
    freed, glibc takes the next large blocks from the heap, and small blocks then fragment the gaps: the memory in use was constant at
    111.9 MB, but the resident memory grew by 4 MB in 1000 pairs.
    """
    _single_arena(_LARGE_BYTES)


def single_arena_for_matrices() -> None:
    """Use one heap for all threads, and separate memory for blocks above 4 MB; to be called before threads are started.

    With a heap for each of its two threads, the largest diagnosis needed 2.1 GB instead of 1.7 GB. With separate memory for blocks above
    128 kB, whose pages are new each time, the system took a third of the processor time of another one, and stopped both threads meanwhile:
    71 s and 1.66 GB instead of 54 s and 1.77 GB.
    """
    _single_arena(_MATRIX_BYTES)
    if _OPTION is not None:
        _OPTION(_TRIM_THRESHOLD, _FREE_HEAP_BYTES)


def _single_arena(large_bytes: int) -> None:
    if _OPTION is not None:
        _OPTION(_ARENA_MAX, 1)
        _OPTION(_MMAP_THRESHOLD, large_bytes)
