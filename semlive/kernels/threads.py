"""Distribution of work over threads: the calling threads and a limited number of helper threads per process.

Threads are used instead of the parallel loops of numba: every kernel releases the interpreter lock, a result does not depend on the
distribution of work, forked processes work (GNU OpenMP aborts in them), and compiling takes half as long.

The calling thread works, too, and starts helpers up to the limit. It checks the limit before each piece of work, so that helpers that
become free are used.
"""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable
from typing import Generic, TypeVar, cast

from numba.core import config

A = TypeVar("A")
B = TypeVar("B")

_helping: list[None] = []  # one entry for each helper at work; appending and popping are atomic


def thread_count() -> int:
    """Threads the kernels use: the processors this process may run on, or NUMBA_NUM_THREADS."""
    return int(config.NUMBA_NUM_THREADS)  # pyright: ignore[reportAttributeAccessIssue]  (set at import, from the environment)


def update_thread_count() -> None:
    """Read NUMBA_NUM_THREADS again, as Numba does whenever it compiles."""
    config.reload_config()


class _Helper(Generic[A]):
    """Work of a helper thread; if the thread has not started it when the result is needed, the calling thread does it.

    The caller does not wait for the start of the thread. Without memory a thread can end before its first line, and
    `threading.Thread.start` then waits forever (this blocked an analysis). Each helper is a new thread, because the queue and the locks
    of a pool take as long as starting a thread.
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
        """Wait until the work is done; return False, and cancel the work, if it has not started."""
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
    """Start work in a separate thread, unless the permitted number of threads is busy."""
    _helping.append(None)  # first, so that of two who ask at once at most too few are served
    if len(_helping) >= thread_count():
        _helping.pop()
        return None
    try:
        return _Helper(work)
    except RuntimeError:  # no more threads are to be had
        _helping.pop()
        return None


def parallel_chunks(work: Callable[[int, int], object], count: int, chunk: int, most: int | None = None) -> None:
    """Call work(first, last) over chunks of range(count) in threads, at most so many if `most` is given."""
    threads = thread_count() if most is None else min(thread_count(), most)
    todo = iter([(first, min(first + chunk, count)) for first in range(0, count, chunk)])
    if threads == 1 or count <= chunk:
        for first, last in todo:
            work(first, last)
        return

    def help_out() -> None:
        for first, last in todo:
            work(first, last)

    helpers: list[_Helper[None]] = []
    try:
        for first, last in todo:
            if len(helpers) < threads - 1 and (helper := _helper(help_out)):
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
