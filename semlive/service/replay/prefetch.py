"""Prefetching: the next items are computed in a separate thread while the last one is used."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import TypeVar

T = TypeVar("T")
_LOOK_S = 0.1  # how often one who waits for room looks whether anybody still wants more


def prefetch(items: Iterator[T], count: int = 2) -> Iterator[T]:
    """Yield the items in order, with at most `count` computed in advance.

    An exception during the computation is raised in place of the next item. Closing the iterator stops the computation.
    """
    made: queue.Queue[tuple[T] | BaseException | None] = queue.Queue(count)
    over = threading.Event()

    def put(one: tuple[T] | BaseException | None) -> None:
        while not over.is_set():
            try:
                made.put(one, timeout=_LOOK_S)
                return
            except queue.Full:
                continue

    def make() -> None:
        try:
            for one in items:
                put((one,))
                if over.is_set():
                    return
        except BaseException as error:
            put(error)
        else:
            put(None)

    thread = threading.Thread(target=make, name="ahead", daemon=True)
    thread.start()
    try:
        while (one := made.get()) is not None:
            if isinstance(one, BaseException):
                raise one
            yield one[0]
    finally:
        over.set()
        thread.join()
