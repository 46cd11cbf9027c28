"""Independent work on all cores: the same as one after the other."""

from __future__ import annotations

import threading

import pytest

from semlive.diagnose import side_by_side as beside


def test_results_come_in_the_order_of_what_was_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "cores", lambda: 2)
    second = threading.Event()

    def work(number: int) -> int:
        if number == 0:
            assert second.wait(10.0)  # so they do run side by side
        elif number == 1:
            second.set()
        return number * number

    assert beside.side_by_side(work, range(5)) == [0, 1, 4, 9, 16]


@pytest.mark.parametrize("count", [1, 2])
def test_what_work_raises_comes_out(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(beside, "cores", lambda: count)
    with pytest.raises(ZeroDivisionError):
        beside.side_by_side(lambda one: 1 // one, [1, 0, 2])


def test_one_core_starts_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "cores", lambda: 1)
    assert set(beside.side_by_side(lambda _: threading.current_thread().name, range(3))) == {threading.current_thread().name}
