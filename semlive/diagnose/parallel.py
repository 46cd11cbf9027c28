"""Work that has nothing to do with each other, two at a time: linear algebra, which most of a verdict is, lets other threads run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

# A machine at an instrument has two cores at least, and every family that is asked at once takes up to a tenth of a gigabyte more.
WORKERS = 2


def parallel_map(work: Callable[[T], R], many: Iterable[T]) -> list[R]:
    """What work makes of each, in their order; what it raises of the first that raises."""
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(work, many))
