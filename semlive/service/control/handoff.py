"""Bounded handoff of messages from another thread to the loop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
_MAX_PENDING = 64
_TIMEOUT_S = 1.0


class BoundedHandoff(Generic[T]):
    """Passes items to a loop in their order and blocks while too many of them are pending.

    When the analysis reports all pairs again, it sends thousands of messages at once. Unbounded, they used 1 kB for every pair of the run,
    and Python does not return such memory to the system.

    Args:
        call_soon: schedules a call in the loop, from any thread.
        consume: processes an item, in the loop.
        max_pending: largest number of pending items.
        timeout_s: longest wait, s; after it the item is passed on, because the loop is blocked or closed.
    """

    def __init__(
        self,
        call_soon: Callable[[Callable[[], None]], None],
        consume: Callable[[T], None],
        max_pending: int = _MAX_PENDING,
        timeout_s: float = _TIMEOUT_S,
    ) -> None:
        self._call_soon, self._consume, self._timeout_s = call_soon, consume, timeout_s
        self._capacity = threading.Semaphore(max_pending)

    def __call__(self, item: T) -> None:
        """Pass an item to the loop; to be called from one thread only."""
        acquired = self._capacity.acquire(timeout=self._timeout_s)

        def deliver() -> None:
            if acquired:
                self._capacity.release()
            self._consume(item)

        self._call_soon(deliver)
