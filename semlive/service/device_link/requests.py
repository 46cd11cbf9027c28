"""Requests of control to a link thread: keep-alive signals, orders, stop and close.

Theory of operation
-------------------
This object is the only state that control writes and the link thread reads. One condition guards it. The methods of control return at
once. `sleep` is the only method that blocks: the link thread waits in it until its next reading is due or a request arrives.
"""

from __future__ import annotations

import threading
from collections import deque

from semlive.ports import ClockSource
from semlive.service.device_link.ports import Order

MAX_SLEEP_S = 0.05
"""Longest sleep of the link thread between two cycles, s."""


class LinkRequests:
    """Queue of orders, with the flags for stop and close and the time of the last keep-alive signal.

    Args:
        clock: the monotonic clock.
    """

    def __init__(self, clock: ClockSource) -> None:
        self._clock = clock
        self._changed = threading.Condition()
        self._orders: deque[Order] = deque()
        self._stop = False
        self._closing = False
        self._alive_mono_ns = clock.mono_ns()

    # ------------------------------------------------------------------ called by control

    def keep_alive(self) -> None:
        """Store the time as that of the last sign that control is alive."""
        with self._changed:
            self._alive_mono_ns = self._clock.mono_ns()

    def send(self, order: Order) -> None:
        """Queue an order."""
        with self._changed:
            self._orders.append(order)
            self._changed.notify_all()

    def stop(self) -> None:
        """Request a stop and discard the queued orders."""
        with self._changed:
            self._orders.clear()
            self._stop = True
            self._changed.notify_all()

    def close(self) -> bool:
        """Request the end of the thread and discard the queued orders; return whether this is the first such request."""
        with self._changed:
            self._orders.clear()
            first, self._closing = not self._closing, True
            self._changed.notify_all()
        return first

    # ------------------------------------------------------------------ called by the link thread

    @property
    def closing(self) -> bool:
        """Whether the thread must end."""
        return self._closing

    @property
    def stop_waits(self) -> bool:
        """Whether a stop is requested that `take_stop` has not returned."""
        return self._stop

    def silent_ns(self, now_mono_ns: int) -> int:
        """Time since the last keep-alive signal, ns."""
        return now_mono_ns - self._alive_mono_ns

    def take_stop(self) -> bool:
        """Return whether a stop was requested since the last call."""
        with self._changed:
            requested, self._stop = self._stop, False
        return requested

    def take_order(self) -> Order | None:
        """Remove and return the oldest order; None without one."""
        with self._changed:
            return self._orders.popleft() if self._orders else None

    def discard_orders(self) -> None:
        """Discard the queued orders."""
        with self._changed:
            self._orders.clear()

    def sleep(self, next_poll_mono_ns: int | None, takes_orders: bool) -> None:
        """Wait until the next reading is due or a request arrives, at most `MAX_SLEEP_S`.

        Args:
            next_poll_mono_ns: time of the next reading; None without a link.
            takes_orders: whether the thread would execute an order now, so a queued order ends the wait.
        """
        with self._changed:
            if self._stop or self._closing or (self._orders and takes_orders):
                return
            until_s = MAX_SLEEP_S if next_poll_mono_ns is None else (next_poll_mono_ns - self._clock.mono_ns()) / 1e9
            if until_s > 0:
                self._changed.wait(min(until_s, MAX_SLEEP_S))
