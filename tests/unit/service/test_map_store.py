"""Maps in temporary files: the same numbers, aligned, read-only, also after their pages were released."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.service.storage import map_store
from semlive.service.storage.map_store import MapStore

GRID = Grid(10, 20, 5, 40, 30, 43)
RNG = np.random.default_rng(1)


def random_map(number: int) -> DisparityMap:
    fields = (RNG.normal(size=GRID.shape) for _ in range(5))
    return DisparityMap(0, number, GRID, *fields, RNG.integers(0, 3, GRID.shape).astype(np.uint8))


def test_maps_come_back_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_store, "_SLAB_BYTES", 256 * 1024)  # five maps of 50 kB
    store, given = MapStore(in_memory_bytes=100_000), [random_map(number) for number in range(40)]
    stored = [store.store_map(item) for item in given]
    store.flush()
    assert stored[0] is given[0]  # as long as there is room
    assert stored[-1] is not given[-1]
    for before, after in zip(given, stored, strict=True):
        for field in dataclasses.fields(DisparityMap):
            item, other = getattr(before, field.name), getattr(after, field.name)
            np.testing.assert_array_equal(item, other)
            if isinstance(other, np.ndarray):
                assert other.ctypes.data % 8 == 0
                assert not other.flags.writeable
                assert other.dtype == item.dtype


def test_a_stored_array_outlives_its_store() -> None:
    store = MapStore(in_memory_bytes=0)
    given = random_map(2)
    stored = store.store_map(given)
    store.flush()
    del store
    np.testing.assert_array_equal(stored.u_px, given.u_px)


def test_pages_given_back_do_not_count_as_memory(tmp_path: Path) -> None:
    status = Path("/proc/self/smaps_rollup")
    if not status.exists():  # only on Linux
        return

    def mapped_kb() -> int:
        (line,) = (item for item in status.read_text().splitlines() if item.startswith("Rss:"))
        return int(line.split()[1])

    store, item = MapStore(in_memory_bytes=0), random_map(2)
    before = mapped_kb()
    stored = [store.store_map(item) for _ in range(1000)]  # 50 MB
    assert all(item.status.any() and item.u_px.any() and item.v_px.any() for item in stored)
    full = mapped_kb()
    with store.flushing():
        pass
    assert full - before > 40_000
    assert mapped_kb() - before < 15_000
    assert len(stored) == 1000
