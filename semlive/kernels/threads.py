"""Work over threads: those that call, and helpers, never more of these than are allowed in the whole process.

Threads, not numba's own parallel loops: every kernel releases the interpreter lock, a result never depends on how work was
dealt out, nothing breaks in a forked process (GNU OpenMP aborts there), and compiling takes half as long.

Whoever calls works too, and takes on helpers while there are fewer than allowed. It looks for one before each piece of work, so that
a thread that another chain of work has done with goes on with this one.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from numba.core import config

A = TypeVar("A")
B = TypeVar("B")

_helping: list[None] = []  # one for each thread at work beside those that called; appending and popping are atomic


def thread_count() -> int:
    """Threads the kernels use: the processors this process may run on, or NUMBA_NUM_THREADS."""
    return int(config.NUMBA_NUM_THREADS)  # pyright: ignore[reportAttributeAccessIssue]  (set at import, from the environment)


def _helper(pool: ThreadPoolExecutor, work: Callable[[], A]) -> Future[A] | None:
    """Work begun in a thread of the pool, unless as many as are allowed are at work."""
    _helping.append(None)  # first, so that of two who ask at once at most too few are served
    if len(_helping) >= thread_count():
        _helping.pop()
        return None

    def help_out() -> A:
        try:
            return work()
        finally:
            _helping.pop()

    return pool.submit(help_out)


def spread(work: Callable[[int, int], object], count: int, chunk: int) -> None:
    """Call work(first, last) over chunks of range(count) in threads."""
    todo = iter([(first, min(first + chunk, count)) for first in range(0, count, chunk)])
    if thread_count() == 1 or count <= chunk:
        for first, last in todo:
            work(first, last)
        return

    def help_out() -> None:
        for first, last in todo:
            work(first, last)

    with ThreadPoolExecutor(thread_count()) as pool:
        helpers = []
        for first, last in todo:
            if len(helpers) < thread_count() - 1 and (helper := _helper(pool, help_out)):
                helpers.append(helper)
            work(first, last)
        for helper in helpers:
            helper.result()


def at_once(one: Callable[[], A], other: Callable[[], B]) -> tuple[A, B]:
    """What two functions return that have nothing to do with one another, called at the same time if a thread is free."""
    with ThreadPoolExecutor(1) as pool:
        helper = _helper(pool, other)
        first = one()
        return first, helper.result() if helper else other()
