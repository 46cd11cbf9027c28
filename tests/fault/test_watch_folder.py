"""The export folder as instruments leave it: half written, preallocated, renamed, overwritten, copied, cleared."""

from __future__ import annotations

import os
import threading
import time
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import tifffile

from semlive.data.frame import ExportedFile
from semlive.errors import BadConfig
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.thread import FolderWatcher
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings

from .by_hand import HandClock, image


@dataclass
class Watched:
    """A watched folder and all reports about it."""

    path: Path
    settings: WatchSettings
    clock: HandClock = field(default_factory=HandClock)
    files: list[ExportedFile] = field(default_factory=list)
    refused: list[RejectedFile] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)

    def open(self) -> Watched:
        self.folder = ExportFolder(self.settings, self.clock, self.files.append, self.refused.append, self.troubles.append)
        self.folder.open()
        return self

    def wait(self, seconds: float = 5.0) -> None:
        for _ in range(round(seconds)):
            self.folder.poll()
            self.clock.ns += 10**9
        self.folder.poll()


@pytest.fixture
def watched(tmp_path: Path) -> Watched:
    return Watched(tmp_path, WatchSettings(tmp_path, stable_for_s=2.0, give_up_after_s=20.0)).open()


def test_a_file_is_delivered_once_with_its_bytes_after_it_was_unchanged(watched: Watched) -> None:
    (watched.path / "a.tif").write_bytes(image(1))
    watched.wait(1)
    assert watched.files == []
    watched.wait(4)
    [file] = watched.files
    assert (file.index, file.name, file.data) == (0, "a.tif", image(1))
    assert file.mtime_ns == (watched.path / "a.tif").stat().st_mtime_ns
    assert file.arrival_time_ns <= watched.clock.ns
    watched.wait(10)
    assert len(watched.files) == 1
    assert watched.refused == []


def test_a_slowly_written_file_is_delivered_complete(watched: Watched) -> None:
    data = image(1)
    for end in range(100, len(data), 300):
        (watched.path / "a.tif").write_bytes(data[:end])
        watched.wait(3)  # unchanged for longer than stable_for_s, but incomplete
    assert watched.files == []
    (watched.path / "a.tif").write_bytes(data)
    watched.wait(5)
    assert [file.data for file in watched.files] == [data]
    assert watched.refused == []


def test_a_file_cut_just_behind_its_pixels_waits_for_its_metadata(watched: Watched) -> None:
    stream = BytesIO()
    pixels = np.random.default_rng(1).integers(0, 255, (40, 50), dtype=np.uint8)
    tifffile.imwrite(stream, pixels, metadata=None, extratags=[(34682, 2, 0, "[User]\nDate=1\n" * 9, True)])
    data = stream.getvalue()
    (watched.path / "a.tif").write_bytes(data[: data.index(b"[User]") + 20])
    watched.wait(8)
    assert watched.files == []
    (watched.path / "a.tif").write_bytes(data)
    watched.wait(8)
    assert len(watched.files) == 1


def test_temporary_names_and_other_files_are_not_looked_at(watched: Watched) -> None:
    (watched.path / "a.tif.tmp").write_bytes(image(1)[:100])
    (watched.path / "notes.txt").write_text("hello")
    (watched.path / "folder.tif").mkdir()
    watched.wait(8)
    (watched.path / "a.tif.tmp").write_bytes(image(1))
    (watched.path / "a.tif.tmp").rename(watched.path / "a.tif")
    watched.wait(5)
    assert [file.name for file in watched.files] == ["a.tif"]
    assert watched.refused == []


def test_a_file_renamed_while_it_is_watched_is_no_loss(watched: Watched) -> None:
    (watched.path / "x1.tif").write_bytes(image(1))
    watched.wait(1)
    (watched.path / "x1.tif").rename(watched.path / "a.tif")
    watched.wait(5)
    assert [file.name for file in watched.files] == ["a.tif"]
    assert watched.refused == []


def test_files_are_delivered_in_order_of_their_time(watched: Watched) -> None:
    for number, name in enumerate(("c.tif", "a.tif", "b.tif")):
        (watched.path / name).write_bytes(image(number))
        os.utime(watched.path / name, ns=(0, 10**18 + number))
    watched.wait(5)
    assert [(file.name, file.index) for file in watched.files] == [("c.tif", 0), ("a.tif", 1), ("b.tif", 2)]


def test_the_same_bytes_under_a_new_name_are_refused_by_name(watched: Watched) -> None:
    (watched.path / "a.tif").write_bytes(image(1))
    watched.wait(5)
    (watched.path / "b.tif").write_bytes(image(1))
    watched.wait(10)
    assert len(watched.files) == 1
    [refused] = watched.refused
    assert refused.name == "b.tif"
    assert "same bytes as a.tif" in refused.reason
    assert refused.sha256 == watched.files[0].sha256


def test_an_overwritten_file_is_reported_once_and_never_taken_again(watched: Watched) -> None:
    (watched.path / "a.tif").write_bytes(image(1))
    watched.wait(5)
    for end in (500, 1000, len(image(2))):
        (watched.path / "a.tif").write_bytes(image(2)[:end])
        watched.wait(1)
    watched.wait(10)
    assert len(watched.files) == 1
    assert [refused.name for refused in watched.refused] == ["a.tif"]
    assert "overwritten" in watched.refused[0].reason
    assert "export 0" in watched.refused[0].reason


def test_files_from_before_are_no_files_of_this_run(tmp_path: Path) -> None:
    (tmp_path / "old.tif").write_bytes(image(1))
    watched = Watched(tmp_path, WatchSettings(tmp_path)).open()
    watched.wait(10)
    assert watched.files == []
    (tmp_path / "old.tif").write_bytes(image(2) + b"x")
    watched.wait(10)
    assert "was there before the run" in watched.refused[0].reason
    adopting = Watched(tmp_path, WatchSettings(tmp_path, adopt=True, first_export=5)).open()
    adopting.wait(10)
    assert [(file.name, file.index) for file in adopting.files] == [("old.tif", 5)]


def test_an_incomplete_file_is_refused_once_and_taken_if_completed_later(watched: Watched) -> None:
    (watched.path / "a.tif").write_bytes(image(1)[:700])
    watched.wait(60)
    [refused] = watched.refused
    assert "never became complete" in refused.reason
    (watched.path / "a.tif").write_bytes(image(1))
    watched.wait(10)
    assert len(watched.files) == 1
    assert len(watched.refused) == 1


def test_an_unreadable_file_is_refused_with_the_reason(watched: Watched) -> None:
    if os.geteuid() == 0:
        os.symlink(watched.path / "a.tif", watched.path / "a.tif")  # root reads everything; a loop it cannot
        (watched.path / "b.tif").write_bytes(b"")
    else:
        (watched.path / "b.tif").write_bytes(image(1))
        (watched.path / "b.tif").chmod(0)
    watched.wait(60)
    assert [refused.name for refused in watched.refused] == ["b.tif"]


def test_a_file_deleted_before_it_was_complete_is_reported(watched: Watched) -> None:
    (watched.path / "a.tif").write_bytes(image(1)[:700])
    watched.wait(3)
    (watched.path / "a.tif").unlink()
    watched.wait(3)
    assert "disappeared" in watched.refused[0].reason


def test_a_missing_folder_gives_one_message_and_a_vanishing_one_is_survived(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match=r"export folder cannot be read.*sem\.folder"):
        Watched(tmp_path / "no", WatchSettings(tmp_path / "no")).open()
    path = tmp_path / "export"
    path.mkdir()
    watched = Watched(path, WatchSettings(path)).open()
    path.rename(tmp_path / "away")
    watched.wait(5)
    (tmp_path / "away").rename(path)
    (path / "a.tif").write_bytes(image(1))
    watched.wait(5)
    assert ["tried again" in trouble for trouble in watched.troubles] == [True, False]
    assert len(watched.files) == 1


class WallClock(HandClock):
    """Real monotonic time."""

    def mono_ns(self) -> int:
        return time.monotonic_ns()


def test_the_thread_delivers_soon_and_stops(tmp_path: Path) -> None:
    came = threading.Event()
    files: list[ExportedFile] = []

    def take(file: ExportedFile) -> None:
        files.append(file)
        if len(files) == 3:
            came.set()

    settings = WatchSettings(tmp_path, poll_s=0.02, stable_for_s=0.1)
    refused: list[RejectedFile] = []
    watcher = FolderWatcher(settings, WallClock(), take, refused.append, lambda text: None)
    watcher.start()
    for number in range(3):
        data = image(number)
        with (tmp_path / f"{number}.tif").open("wb") as stream:
            for at in range(0, len(data), 500):
                stream.write(data[at : at + 500])
                stream.flush()
                threading.Event().wait(0.01)
    watcher.wake()
    assert came.wait(100)
    watcher.close()
    watcher.close()
    assert [file.data for file in files] == [image(number) for number in range(3)]
    assert refused == []


def test_a_giant_file_is_refused_unread(tmp_path: Path) -> None:
    watched = Watched(tmp_path, WatchSettings(tmp_path, max_bytes=1000)).open()
    (tmp_path / "a.tif").write_bytes(image(1))
    watched.wait(8)
    assert watched.files == []
    [refused] = watched.refused
    assert "larger than 1000 bytes" in refused.reason


def test_a_share_that_numbers_its_files_again_has_nothing_refused_again(tmp_path: Path) -> None:
    watched = Watched(tmp_path, WatchSettings(tmp_path, max_bytes=1000, vendor="jeol")).open()
    text = tmp_path / "a.txt"
    (tmp_path / "a.tif").write_bytes(image(1))
    text.write_bytes(b"$CM_FORMAT JEOL-SEM\r\n")
    watched.wait(8)
    before = text.stat()
    (tmp_path / "kept").write_bytes(text.read_bytes())
    text.unlink()
    (tmp_path / "kept").rename(text)
    os.utime(text, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert text.stat().st_ino != before.st_ino
    watched.wait(8)
    assert len(watched.refused) == 1


def test_a_dead_watch_is_detected(tmp_path: Path) -> None:
    def break_down(file: ExportedFile) -> None:
        raise RuntimeError(file.name)

    reported: list[str] = []
    refused: list[RejectedFile] = []
    watcher = FolderWatcher(
        WatchSettings(tmp_path, poll_s=0.02, stable_for_s=0.05), WallClock(), break_down, refused.append, reported.append
    )
    watcher.start()
    assert not watcher.failed
    (tmp_path / "a.tif").write_bytes(image(1))
    deadline = time.monotonic() + 100.0
    while not reported and time.monotonic() < deadline:
        time.sleep(0.02)
    assert watcher.failed
    assert "the watch of the export folder failed" in reported[0]
    watcher.close()
