"""What is remembered of exported files: exactly as a dictionary would, in memory that does not grow with them."""

from __future__ import annotations

import hashlib
import inspect
import os
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np

from semlive.service.watch.accepted_files import FileNumbering
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.file_registry import DUPLICATE, PREEXISTING, FileRegistry, RegisteredFile
from semlive.service.watch.watch_settings import WatchSettings

from .by_hand import HandClock, image

FILES, PICTURE = 600, image(1)


def test_the_registry_equals_a_dictionary_beyond_its_capacity() -> None:
    rng, registry = np.random.default_rng(1), FileRegistry(room=16)
    files: dict[str, RegisteredFile] = {}
    for number in range(2000):
        name = f"{'ä' * int(rng.integers(0, 60))}{rng.integers(0, 500)}.tif"
        one = RegisteredFile(
            (int(rng.integers(0, 2**60)), -number, number), number, hashlib.sha256(name.encode()).hexdigest() if number % 3 else ""
        )
        if (before := files.get(name)) is not None:
            one = replace(before, state=one.state, overwritten=not before.overwritten)
        registry.put(name, one)
        files[name] = one
        assert registry.get(name) == one
    assert len(registry) == len(files)
    assert {name: registry.get(name) for name in files} == files
    assert all(registry.is_unchanged(name, one.state) and not registry.is_unchanged(name, (1, 2, 3)) for name, one in files.items())
    assert registry.get("other.tif") is registry.is_unchanged("other.tif", (1, 2, 3)) is None
    for name, one in files.items():
        twin = registry.same_content(one.sha256) if one.sha256 else name
        assert twin is not None
        assert name.startswith(twin)
    assert registry.same_content("00" * 31 + "01") is None


def test_names_that_are_no_text_and_what_became_of_files() -> None:
    registry = FileRegistry(room=16)
    name = os.fsdecode(b"a\xff.tif") if os.name == "posix" else "a.tif"
    sha256 = hashlib.sha256(b"1").hexdigest()
    registry.put(name, RegisteredFile((1, 2, 3), 7, sha256))
    assert registry.get(name) == RegisteredFile((1, 2, 3), 7, sha256)
    assert registry.same_content(sha256) == name.encode("utf-8", "backslashreplace").decode()
    descriptions = [RegisteredFile((1, 2, 3), export).description for export in (7, PREEXISTING, DUPLICATE)]
    assert descriptions == ["was taken as export 7", "was there before the run", "was refused as a copy"]


def test_a_folder_takes_no_more_memory_for_more_files(tmp_path: Path) -> None:
    """Each took 0.6 kB permanently, and 0.4 kB more at every scan."""
    clock, taken = HandClock(), [0]
    settings = WatchSettings(tmp_path, sidecar_timeout_s=2.0)
    folder = ExportFolder(settings, clock, lambda file: taken.append(taken.pop() + 1), print, print)
    folder.open()

    def come(first: int) -> None:
        for begin in range(first, first + FILES, 100):
            for number in range(begin, begin + 100):
                (tmp_path / f"scan_{number:06d}.tif").write_bytes(PICTURE + number.to_bytes(4, "little"))
            for _ in range(5):
                folder.poll()
                clock.ns += 10**9

    def at_a_scan() -> int:
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        folder.poll()
        return tracemalloc.get_traced_memory()[1] - before

    # Threads of other tests may end meanwhile, and take or free what they like: 7.7 MB once.
    here = tracemalloc.Filter(True, inspect.getfile(ExportFolder), all_frames=True)
    # The interpreter's table of interned names, which pathlib fills, grows to 1.9 MB at some file or other, and is nobody's.
    interned = tracemalloc.Filter(False, inspect.getfile(Path))
    come(0)
    tracemalloc.start(5)
    try:
        come(FILES)
        allocations = tracemalloc.take_snapshot().filter_traces([here, interned]).statistics("filename")
        most = min(at_a_scan() for _ in range(5))
    finally:
        tracemalloc.stop()
    assert taken == [2 * FILES]
    assert sum(one.size for one in allocations) < 20 * FILES
    assert most < 20 * FILES


def test_kinds_of_names_are_evicted() -> None:
    names = FileNumbering()
    names.check_gap("a1.tif")
    for minute in range(5000):
        names.check_gap(f"{minute}:01.tif")
    assert names.check_gap("4999:03.tif") is not None
    assert names.check_gap("a9.tif") is None
    assert len(names._newest) <= 100  # pyright: ignore[reportPrivateUsage]
