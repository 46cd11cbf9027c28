"""A serial line without hardware: a pseudo-terminal whose far end has a path that any serial program can open.

Linux (and other systems with pseudo-terminals); not Windows. A pseudo-terminal ignores the baud rate, so the time that the bytes
would need on a wire is waited for here. Parity must be none: the kernel refuses it on a pseudo-terminal.
"""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable

from semlive_simulators.load_frame.line_faults import LineChunk

_BITS_PER_BYTE = 10  # start, 8 data, stop
_MIN_SILENCE_S = 0.004
"""The scheduler's own gaps inside a burst are shorter: 0.3 ms in the median, seldom more than 2 ms."""


class PtyLine:
    """Answers bursts of bytes that end in silence, in a thread of its own.

    Args:
        name: of the thread.
        answer: called with each burst; gives the pieces of the reply, none for silence.
        baud: what the wire would carry.
    """

    def __init__(self, name: str, answer: Callable[[bytes], tuple[LineChunk, ...]], baud: int) -> None:
        self._answer = answer
        self._byte_s = _BITS_PER_BYTE / baud
        self._stop = threading.Event()
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.path = os.ttyname(self._theirs)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start listening."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and take the path away."""
        self._stop.set()
        self._thread.join(timeout=5.0)
        os.close(self._ours)
        os.close(self._theirs)  # open until now, so that the line lives on when a client hangs up

    def _run(self) -> None:
        burst = b""
        silence_s = max(3.5 * self._byte_s, _MIN_SILENCE_S)
        while not self._stop.is_set():
            ready, _, _ = select.select([self._ours], [], [], silence_s if burst else 0.1)
            if ready:
                burst += os.read(self._ours, 4096)
                continue
            if burst:
                reply = self._answer(burst)
                self._stop.wait(self._byte_s * len(burst))
                burst = b""
                for piece in reply:
                    self._stop.wait(piece.wait_s + self._byte_s * len(piece.data))
                    os.write(self._ours, piece.data)
