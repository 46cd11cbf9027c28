"""What another thread says, handed to the loop a little at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")
_AT_A_TIME = 64
_PATIENCE_S = 1.0


class BoundedHandoff(Generic[T]):
    """Hands things to a loop in their order and waits while many of them have not been taken.

    When analysis tells all pairs anew it says thousands of messages at once. Waiting together, they took 1 kB for every pair of the run,
    and Python gives such memory back to no one.

    Args:
        soon: has the loop call something, from any thread.
        take: what the loop does with a thing.
        at_a_time: so many may wait.
        patience_s: a loop that takes none for so long is not waited for: it stands still, or is closed.
    """

    def __init__(
        self,
        soon: Callable[[Callable[[], None]], None],
        take: Callable[[T], None],
        at_a_time: int = _AT_A_TIME,
        patience_s: float = _PATIENCE_S,
    ) -> None:
        self._soon, self._take, self._patience_s = soon, take, patience_s
        self._room = threading.Semaphore(at_a_time)

    def __call__(self, thing: T) -> None:
        """Hand it over; for one thread."""
        held = self._room.acquire(timeout=self._patience_s)

        def take() -> None:
            if held:
                self._room.release()
            self._take(thing)

        self._soon(take)
