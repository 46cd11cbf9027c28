"""Parallel map over independent tasks with two threads. Linear algebra, most of the work of a verdict, releases the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

# A computer at an instrument has at least two cores; each effect class in work needs up to a tenth of a gigabyte of memory.
WORKERS = 2


def parallel_map(work: Callable[[T], R], many: Iterable[T]) -> list[R]:
    """Results of `work` for each item, in order. Raises the exception of the first item that fails."""
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(work, many))
