"""Return of free memory to the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable

_ARENA_MAX, _MMAP_THRESHOLD = -8, -3  # M_ARENA_MAX and M_MMAP_THRESHOLD of malloc.h
_LARGE_BYTES = 128 << 10


def _of_glibc(name: str) -> Callable[..., int] | None:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


_TRIM, _OPTION = _of_glibc("malloc_trim"), _of_glibc("mallopt")


def trim_heap() -> None:
    """Let the C library give back what lies free between what is in use; where it is not glibc, nothing is done.

    By itself it gives back only what is free at the end of its heap: after a choice of the estimator 190 of 360 MB stayed free in between.
    """
    if _TRIM is not None:
        _TRIM(0)


def single_arena() -> None:
    """One heap for all threads; to be called before there are threads.

    A verdict's two threads had a heap of their own each: the largest took 2.1 GB in place of 1.7 GB.
    """
    if _OPTION is not None:
        _OPTION(_ARENA_MAX, 1)


def single_arena_small_blocks() -> None:
    """One heap for all threads, and blocks beyond 128 kB outside of it; to be called before there are threads.

    Each of control's twelve threads had a heap of its own, and what free blocks leave of pages was given back in none of them. Once a
    block of some MB is freed, glibc takes the next ones from the heap, where small ones that stay settle in what they leave: what was in
    use stood still at 111.9 MB, and 4 MB in 1000 pairs were resident beside it.
    """
    single_arena()
    if _OPTION is not None:
        _OPTION(_MMAP_THRESHOLD, _LARGE_BYTES)
