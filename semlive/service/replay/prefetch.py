"""Prefetching: the next items are computed in a separate thread while the last one is used."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import TypeVar

T = TypeVar("T")
_CHECK_S = 0.1  # interval at which a blocked producer checks whether the iterator was closed


def prefetch(items: Iterator[T], count: int = 2) -> Iterator[T]:
    """Yield the items in order, with at most `count` computed in advance.

    An exception during the computation is raised in place of the next item. Closing the iterator stops the computation.
    """
    computed: queue.Queue[tuple[T] | BaseException | None] = queue.Queue(count)
    closed = threading.Event()

    def put(item: tuple[T] | BaseException | None) -> None:
        while not closed.is_set():
            try:
                computed.put(item, timeout=_CHECK_S)
                return
            except queue.Full:
                continue

    def make() -> None:
        try:
            for item in items:
                put((item,))
                if closed.is_set():
                    return
        except BaseException as error:
            put(error)
        else:
            put(None)

    thread = threading.Thread(target=make, name="ahead", daemon=True)
    thread.start()
    try:
        while (item := computed.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item[0]
    finally:
        closed.set()
        thread.join()
