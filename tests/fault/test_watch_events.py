"""File-system events wake the scan; where none arrive, or the observer fails, a note reports it and the scan continues alone."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from semlive.data.frame import ExportedFile
from semlive.service.runtime.clock import SystemClock
from semlive.service.watch.folder_events import FolderEvents
from semlive.service.watch.thread import FolderWatcher
from semlive.service.watch.watch_settings import WatchSettings
from semlive_simulators.exporters.settings import Vendor

from ..waiting import PATIENCE_S, wait_until
from .by_hand import image
from .test_watch_at_once import exported


class Observed:
    """Events of a folder, and the reports about them."""

    def __init__(self, folder: Path) -> None:
        self.woken, self.notices = threading.Event(), list[str]()
        self.events = FolderEvents(folder, self.woken.set, self.notices.append)
        self.events.start()


@pytest.fixture
def observe() -> Iterator[Callable[[Path], Observed]]:
    received: list[Observed] = []

    def start(folder: Path) -> Observed:
        received.append(Observed(folder))
        return received[-1]

    yield start
    for observed in received:
        observed.events.close()


def test_events_wake_scans_that_would_come_in_ten_minutes_and_all_threads_end(tmp_path: Path) -> None:
    before, came = set(threading.enumerate()), threading.Semaphore(0)
    files: list[ExportedFile] = []

    def take(file: ExportedFile) -> None:
        files.append(file)
        came.release()

    watcher = FolderWatcher(WatchSettings(tmp_path, poll_s=600.0), SystemClock(), take, print, print)
    watcher.start()
    time.sleep(0.3)
    written = [exported(Vendor.FEI, seed) for seed in range(20)]
    for number, data in enumerate(written):  # the second event comes while the file is new
        with (tmp_path / f"{number:02d}.tif").open("wb", buffering=0) as stream:
            stream.write(data[:1000])
            time.sleep(number * 1e-3)
            stream.write(data[1000:])
        assert came.acquire(timeout=PATIENCE_S), number
    watcher.close()
    remaining = [thread.name for thread in set(threading.enumerate()) - before if thread.name != "file-reader"]
    assert remaining == []
    assert [file.data for file in files] == written


def test_reading_a_file_triggers_no_scan(tmp_path: Path, observe: Callable[[Path], Observed]) -> None:
    (tmp_path / "a.tif").write_bytes(image(1))
    observed = observe(tmp_path)
    (tmp_path / "a.tif").read_bytes()
    assert not observed.woken.wait(0.3)
    (tmp_path / "a.tif").write_bytes(image(2))
    assert observed.woken.wait(PATIENCE_S)


def test_an_observer_that_cannot_start_is_one_note(tmp_path: Path, observe: Callable[[Path], Observed]) -> None:
    observed = observe(tmp_path / "no")
    for _ in range(5):
        observed.events.follow(is_woken=False, has_news=True)
    assert len(observed.notices) == 1
    assert "file-system events are not available" in observed.notices[0]
    assert "scanned every sem.poll_s instead" in observed.notices[0]


def test_a_folder_that_is_removed_ends_its_observer_with_a_note(tmp_path: Path, observe: Callable[[Path], Observed]) -> None:
    folder = tmp_path / "export"
    folder.mkdir()
    observed = observe(folder)
    folder.rmdir()

    def noted() -> bool:
        observed.events.follow(is_woken=False, has_news=False)
        return bool(observed.notices)

    wait_until(noted)
    assert "the observer of file-system events has ended" in observed.notices[0]


def test_a_share_without_events_is_one_note_until_events_come(tmp_path: Path, observe: Callable[[Path], Observed]) -> None:
    observed = observe(tmp_path)
    for is_woken, has_news in [(False, True), (True, False), (False, True), (False, True)]:
        observed.events.follow(is_woken=is_woken, has_news=has_news)
    assert observed.notices == []  # a scan that was due may be ahead of an event
    for _ in range(9):
        observed.events.follow(is_woken=False, has_news=True)
    assert ["no file-system events arrive" in notice for notice in observed.notices] == [True]
    for is_woken in (True, False, False, False):
        observed.events.follow(is_woken=is_woken, has_news=True)
    assert len(observed.notices) == 2


def test_lost_events_are_a_note_and_a_scan(tmp_path: Path, observe: Callable[[Path], Observed]) -> None:
    observed = observe(tmp_path)
    logging.getLogger("watchdog.observers.inotify_c").warning("Inotify queue overflowed; filesystem events were lost")
    assert observed.woken.is_set()
    observed.events.follow(is_woken=True, has_news=False)
    assert "Inotify queue overflowed" in observed.notices[0]
