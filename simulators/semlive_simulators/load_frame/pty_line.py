"""A serial line without hardware: a pseudo-terminal with a path that any serial program can open.

For Linux and other systems with pseudo-terminals; not for Windows. A pseudo-terminal ignores the baud rate, so this module waits for the
time of the bytes on a wire. Parity must be none, because the kernel refuses others on a pseudo-terminal.
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
"""Gaps within a burst by the scheduler are shorter: 0.3 ms in the median, seldom more than 2 ms."""


class PtyLine:
    """Answers bursts of bytes that end in silence, in a separate thread.

    Args:
        name: name of the thread.
        answer: called with each burst; returns the chunks of the reply, none for silence.
        baud: simulated baud rate.
    """

    def __init__(self, name: str, answer: Callable[[bytes], tuple[LineChunk, ...]], baud: int) -> None:
        self._answer = answer
        self._byte_s = _BITS_PER_BYTE / baud
        self._stop = threading.Event()
        self._server_end, self._client_end = os.openpty()
        tty.setraw(self._client_end)
        self.path = os.ttyname(self._client_end)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start listening."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and remove the path."""
        self._stop.set()
        self._thread.join(timeout=5.0)
        os.close(self._server_end)
        os.close(self._client_end)  # open until now, so that the line stays open when a client closes it

    def _run(self) -> None:
        burst = b""
        silence_s = max(3.5 * self._byte_s, _MIN_SILENCE_S)
        while not self._stop.is_set():
            ready, _, _ = select.select([self._server_end], [], [], silence_s if burst else 0.1)
            if ready:
                burst += os.read(self._server_end, 4096)
                continue
            if burst:
                reply = self._answer(burst)
                self._stop.wait(self._byte_s * len(burst))
                burst = b""
                for chunk in reply:
                    self._stop.wait(chunk.wait_s + self._byte_s * len(chunk.data))
                    os.write(self._server_end, chunk.data)
