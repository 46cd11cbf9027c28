"""Work ahead: order, errors and an early end are as without."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from semlive.service.replay.prefetch import prefetch


def test_everything_comes_in_its_order() -> None:
    assert list(prefetch(iter(range(100)))) == list(range(100))
    assert list(prefetch(iter(()))) == []


def test_what_making_raises_is_raised_where_the_next_would_be() -> None:
    def made() -> Iterator[int]:
        yield 1
        raise ValueError("the second is damaged")

    found = prefetch(made())
    assert next(found) == 1
    with pytest.raises(ValueError, match="second is damaged"):
        next(found)


def test_whoever_stops_asking_stops_the_making_too() -> None:
    made: list[int] = []

    def numbers() -> Iterator[int]:
        while True:
            made.append(len(made))
            yield made[-1]

    found = prefetch(numbers(), 2)
    assert [next(found), next(found)] == [0, 1]
    found.close()  # pyright: ignore[reportAttributeAccessIssue]  (a generator)
    assert not any(item.name == "ahead" for item in threading.enumerate())
    assert len(made) <= 6
