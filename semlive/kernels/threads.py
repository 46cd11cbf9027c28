"""Work over threads: those that call, and helpers, never more of these than are allowed in the whole process.

Threads, not numba's own parallel loops: every kernel releases the interpreter lock, a result never depends on how work was
dealt out, nothing breaks in a forked process (GNU OpenMP aborts there), and compiling takes half as long.

Whoever calls works too, and takes on helpers while there are fewer than allowed. It looks for one before each piece of work, so that
a thread that another chain of work has done with goes on with this one.
"""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable
from typing import Generic, TypeVar, cast

from numba.core import config

A = TypeVar("A")
B = TypeVar("B")

_helping: list[None] = []  # one for each thread at work beside those that called; appending and popping are atomic


def thread_count() -> int:
    """Threads the kernels use: the processors this process may run on, or NUMBA_NUM_THREADS."""
    return int(config.NUMBA_NUM_THREADS)  # pyright: ignore[reportAttributeAccessIssue]  (set at import, from the environment)


class _Helper(Generic[A]):
    """Work done beside the caller's, unless the caller has done with its own before it began: then whoever waits does it.

    Nobody waits for a thread to begin. Where memory is refused it may end before it runs a line, and `threading.Thread.start` then waits
    for good: the analysis of a run hung in it. A thread of its own each: a pool's queue and locks cost as much again as beginning one.
    """

    def __init__(self, work: Callable[[], A]) -> None:
        self._work = work
        self._begun, self._over = threading.Lock(), threading.Lock()
        self._over.acquire()
        self._result: A | None = None
        self._error: BaseException | None = None
        _thread.start_new_thread(self._run, ())

    def _run(self) -> None:
        if not self._begun.acquire(blocking=False):
            return
        try:
            self._result = self._work()
        except BaseException as error:
            self._error = error
        finally:
            _helping.pop()
            self._over.release()

    def wait(self) -> bool:
        """Until the work is done; False where it has not begun, and then never does."""
        if self._begun.acquire(blocking=False):
            _helping.pop()
            return False
        with self._over:
            return True

    def result(self) -> A:
        """What the work returned or raised; after `wait`."""
        if self._error is not None:
            raise self._error
        return cast(A, self._result)


def _helper(work: Callable[[], A]) -> _Helper[A] | None:
    """Work begun in a thread of its own, unless as many as are allowed are at work."""
    _helping.append(None)  # first, so that of two who ask at once at most too few are served
    if len(_helping) >= thread_count():
        _helping.pop()
        return None
    try:
        return _Helper(work)
    except RuntimeError:  # no more threads are to be had
        _helping.pop()
        return None


def parallel_chunks(work: Callable[[int, int], object], count: int, chunk: int) -> None:
    """Call work(first, last) over chunks of range(count) in threads."""
    todo = iter([(first, min(first + chunk, count)) for first in range(0, count, chunk)])
    if thread_count() == 1 or count <= chunk:
        for first, last in todo:
            work(first, last)
        return

    def help_out() -> None:
        for first, last in todo:
            work(first, last)

    helpers: list[_Helper[None]] = []
    try:
        for first, last in todo:
            if len(helpers) < thread_count() - 1 and (helper := _helper(help_out)):
                helpers.append(helper)
            work(first, last)
    finally:
        began = [helper for helper in helpers if helper.wait()]
    for helper in began:
        helper.result()


def run_pair_in_parallel(one: Callable[[], A], other: Callable[[], B], *, worth: bool = True) -> tuple[A, B]:
    """What two functions return that have nothing to do with one another, at the same time if worth a thread and one is free."""
    helper = _helper(other) if worth else None
    try:
        first = one()
    finally:
        began = helper is not None and helper.wait()
    return first, helper.result() if helper and began else other()
