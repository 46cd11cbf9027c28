"""The archive of a live run: what is read back equals what was put in, older shelves stay as they were, files go when nobody needs them."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from semlive.service.storage import map_store
from semlive.service.storage.pair_archive import PairArchive


class Side(Enum):
    LEADING = "leading"


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    number: int
    size_px: float
    name: str
    side: Side | None
    parts: tuple[Any, ...]
    array: NDArray[Any]


ARRAYS = some.one_of(
    *(arrays(dtype, array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5)) for dtype in (np.float64, np.int64, np.uint8, np.bool_))
)
LEAVES = some.one_of(
    some.none(), some.booleans(), some.integers(-(2**80), 2**80), some.floats(allow_nan=False), some.text(), some.just(Side.LEADING)
)
VALUES = some.builds(
    Held,
    some.integers(-(2**63), 2**63 - 1),
    some.floats(allow_nan=False),
    some.text(),
    some.sampled_from([None, Side.LEADING]),
    some.lists(some.one_of(LEAVES, some.tuples(LEAVES, LEAVES))).map(tuple),
    ARRAYS,
)


def same(one: Held, other: Held) -> bool:
    reported = [(each.number, each.size_px, each.name, each.side, each.parts) for each in (one, other)]
    kinds = [[type(part) for part in each.parts] for each in (one, other)]
    same_layout = one.array.dtype == other.array.dtype and one.array.shape == other.array.shape
    return reported[0] == reported[1] and kinds[0] == kinds[1] and same_layout and one.array.tobytes() == other.array.tobytes()


@given(some.lists(VALUES, max_size=6))
def test_values_come_back_as_they_were(values: list[Held]) -> None:
    archive = PairArchive()
    shelf = archive.append((), values)
    archive.flush()
    assert len(shelf) == len(values)
    assert all(same(one, other) for one, other in zip(shelf, values, strict=True))
    assert all(same(one, other) for one, other in zip(reversed(shelf), reversed(values), strict=True))
    assert not any(one.array.flags.writeable for one in shelf if one.array.size)


def held(number: int, size: int = 3) -> Held:
    return Held(number, 0.5 * number, f"frame {number}", Side.LEADING, (), np.arange(size, dtype=np.float64) + number)


def test_a_shelf_that_grows_is_another_one() -> None:
    archive = PairArchive()
    before = archive.append((), [held(0), held(1)])
    one, two = archive.append(before, [held(2)]), archive.append(before, [held(7), held(8)])
    assert [[each.number for each in shelf] for shelf in (before, one, two)] == [[0, 1], [0, 1, 2], [0, 1, 7, 8]]
    assert [each.number for each in two[-3:]] == [1, 7, 8]
    with pytest.raises(IndexError):
        before[2]


def test_what_has_the_same_number_takes_its_place() -> None:
    archive = PairArchive()
    first = archive.update({}, {4: held(4), 0: held(0)})
    second = archive.update(first, {2: held(2), 4: held(40)})
    assert {number: one.number for number, one in first.items()} == {0: 0, 4: 4}
    assert {number: one.number for number, one in second.items()} == {0: 0, 2: 2, 4: 40}
    assert archive.update(second, {}) is second
    with pytest.raises(KeyError):
        second[3]


def test_a_stored_array_is_not_stored_twice() -> None:
    archive = PairArchive()
    stored = archive.store_array(np.arange(1000.0))
    shelf = archive.append((), [Held(0, 0.0, "", None, (), stored)])
    assert np.shares_memory(shelf[0].array, stored)
    assert shelf[0].array.ctypes.data % 64 == 0


def test_memory_order_is_preserved_because_sums_depend_on_it() -> None:
    archive = PairArchive()
    given_ = np.asfortranarray(np.arange(12.0).reshape(3, 4))
    (one,) = archive.append((), [Held(0, 0.0, "", None, (), given_)])
    assert one.array.flags.f_contiguous
    np.testing.assert_array_equal(one.array, given_)


def test_a_file_is_gone_when_no_shelf_holds_anything_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_store, "_SLAB_BYTES", 64 * 1024)
    archive = PairArchive()
    old = archive.append((), [held(number, 4000) for number in range(20)])
    new = archive.append(old[10:], [held(20, 4000)])
    store = archive._store
    alive = sum(one() is not None for one in store._slabs.values())
    del old
    assert sum(one() is not None for one in store._slabs.values()) < alive
    assert [one.number for one in new] == list(range(10, 21))


def test_what_finds_no_room_in_files_stays_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/no/such/folder")
    archive = PairArchive()
    shelf = archive.append((), [held(number) for number in range(3)])
    assert [one.number for one in archive.append(shelf, [held(3)])] == [0, 1, 2, 3]


def test_what_no_value_can_be_made_of_is_refused() -> None:
    with pytest.raises(TypeError, match="unhashable"):
        PairArchive().append((), [[1, 2]])
