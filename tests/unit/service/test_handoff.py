"""Messages of another thread wait in a short queue, in their order, and are not lost if nobody takes them."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from semlive.service.daemon.callbacks import BoundedHandoff


def test_no_more_than_a_few_wait_and_all_come_in_order() -> None:
    waiting, taken, most = queue.SimpleQueue[Callable[[], None]](), list[int](), 0
    handoff = BoundedHandoff(waiting.put, taken.append, max_pending=8, timeout_s=60.0)
    speaker = threading.Thread(target=lambda: [handoff(number) for number in range(500)])
    speaker.start()
    for _ in range(500):
        call = waiting.get(timeout=60.0)
        most = max(most, waiting.qsize() + 1)
        call()
    speaker.join(60.0)
    assert taken == list(range(500))
    assert most <= 9  # the one that is being taken, and those that wait


def test_a_loop_that_takes_nothing_is_not_waited_for() -> None:
    waiting, taken = queue.SimpleQueue[Callable[[], None]](), list[int]()
    handoff = BoundedHandoff(waiting.put, taken.append, max_pending=2, timeout_s=0.01)
    for number in range(5):
        handoff(number)
    assert waiting.qsize() == 5
    for _ in range(5):
        waiting.get()()
    for number in range(2):
        handoff(number)
    assert waiting.qsize() == 2
    assert taken == list(range(5))
