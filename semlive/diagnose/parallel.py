"""Parallel map over independent tasks with two threads. Linear algebra, most of the work of a verdict, releases the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

# A machine at an instrument has two cores at least, and every family that is asked at once takes up to a tenth of a gigabyte more.
WORKERS = 2


def parallel_map(work: Callable[[T], R], many: Iterable[T]) -> list[R]:
    """Results of `work` for each item, in order. Raises the exception of the first item that fails."""
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(work, many))
