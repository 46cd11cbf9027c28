"""Independent work, two at a time: the same as one after the other."""

from __future__ import annotations

import threading

import pytest

from semlive.diagnose.parallel import parallel_map


def test_results_have_the_order_of_their_requests() -> None:
    second = threading.Event()

    def work(number: int) -> int:
        if number == 0:
            assert second.wait(10.0)  # so they do run side by side
        elif number == 1:
            second.set()
        return number * number

    assert parallel_map(work, range(5)) == [0, 1, 4, 9, 16]


def test_what_work_raises_comes_out() -> None:
    with pytest.raises(ZeroDivisionError):
        parallel_map(lambda item: 1 // item, [1, 0, 2])
