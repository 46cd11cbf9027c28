"""Parallel map: results in order, also within another one, and the exception of an item."""

from __future__ import annotations

import pytest

from semlive.diagnose.parallel import parallel_map


def test_results_are_in_the_order_of_the_items() -> None:
    assert parallel_map(lambda item: item * item, iter(range(40))) == [item * item for item in range(40)]
    assert parallel_map(lambda item: item, []) == []


def test_a_map_within_a_map_ends() -> None:
    assert parallel_map(lambda row: sum(parallel_map(lambda column: row * column, range(5))), range(6)) == [10 * row for row in range(6)]


def test_an_exception_is_raised_after_all_threads_have_ended() -> None:
    with pytest.raises(ZeroDivisionError):
        parallel_map(lambda item: 1 // item, [1, 2, 0, 3])
