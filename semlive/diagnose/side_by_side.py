"""Work that has nothing to do with each other, on all cores: linear algebra, which most of a verdict is, lets other threads run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def side_by_side(work: Callable[[T], R], many: Iterable[T]) -> list[R]:
    """What work makes of each, in their order; what it raises of the first that raises."""
    each = list(many)
    threads = min(cores(), len(each))
    if threads < 2:
        return [work(one) for one in each]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, each))
