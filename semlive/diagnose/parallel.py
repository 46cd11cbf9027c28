"""Parallel map over independent tasks with two threads. Linear algebra, most of the work of a verdict, releases the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

from semlive.kernels.threads import parallel_chunks

T = TypeVar("T")
R = TypeVar("R")

# A computer at an instrument has at least two cores; each effect class in work needs up to a tenth of a gigabyte of memory.
WORKERS = 2


def parallel_map(work: Callable[[T], R], many: Iterable[T]) -> list[R]:
    """Results of `work` for each item, in order. Raises an exception of an item that fails.

    A thread pool would wait forever for a thread that ends before its first line because memory is refused, in the analysis of a run too.
    """
    items = list(many)
    results = dict[int, R]()

    def take(first: int, last: int) -> None:
        for place in range(first, last):
            results[place] = work(items[place])

    parallel_chunks(take, len(items), 1, WORKERS)
    return [results[place] for place in range(len(items))]
