"""A device that answers in lines of text over a pseudo-terminal, in a thread; written apart from the drivers."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def over_text(answer: Callable[[str], str], ends: str = "\r", late_s: Callable[[], float] = lambda: 0.0) -> Iterator[str]:
    """Answer each line that ends in `ends`; gives the path. An empty answer is silence."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    over = threading.Event()

    def run() -> None:
        received = ""
        while not over.is_set():
            if not select.select([ours], [], [], 0.05)[0]:
                continue
            received += os.read(ours, 4096).decode("ascii")
            while ends in received:
                line, _, received = received.partition(ends)
                printed = answer(line)
                time.sleep(late_s())
                os.write(ours, printed.encode("ascii"))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        over.set()
        thread.join()
        os.close(ours)
        os.close(theirs)
