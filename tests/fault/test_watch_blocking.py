"""Names in the export folder that lead elsewhere, and another folder in its place: the watch continues, and reports what it omits."""

from __future__ import annotations

import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from semlive.data.frame import ExportedFile
from semlive.service.log.files import messages
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.file_reader import FileReader, StillReading, read_regular
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings

from ..waiting import wait_until
from .by_hand import HandClock, image


@dataclass
class Watched:
    """A watched folder and everything that was reported of it."""

    path: Path
    reader: FileReader = field(default_factory=FileReader)
    clock: HandClock = field(default_factory=HandClock)
    files: list[ExportedFile] = field(default_factory=list)
    refused: list[RejectedFile] = field(default_factory=list)
    replaced: list[str] = field(default_factory=list)

    def open(self) -> Watched:
        settings = WatchSettings(self.path, stable_for_s=2.0, give_up_after_s=20.0)
        self.folder = ExportFolder(
            settings, self.clock, self.files.append, self.refused.append, pytest.fail, on_replaced=self.replaced.append, reader=self.reader
        )
        self.folder.open()
        return self

    def wait(self, seconds: int) -> None:
        for _ in range(seconds):
            self.folder.poll()
            self.clock.ns += 10**9
        self.folder.poll()

    def takes(self, *names: str) -> None:
        """Wait until exactly these files were taken; on a busy computer a read takes longer than its reader waits for it."""

        def taken() -> bool:
            self.folder.poll()
            return len(self.files) >= len(names)

        wait_until(taken)
        assert self.names() == list(names)

    def names(self) -> list[str]:
        return [item.name for item in self.files]


def test_links_to_kernel_files_and_devices_are_refused_and_other_files_are_taken(tmp_path: Path) -> None:
    watched = Watched(tmp_path).open()
    # Reading /proc/kmsg blocks until the kernel logs something; that of /dev/zero never ends; a FIFO waits for a writer.
    os.symlink("/proc/kmsg", tmp_path / "a.tif")
    os.symlink("/dev/zero", tmp_path / "b.tif")
    os.mkfifo(tmp_path / "c.tif")
    os.symlink("/proc/self/mountinfo", tmp_path / "d.tif")
    (tmp_path / "e.tif").write_bytes(image(1))
    began_s = time.monotonic()
    watched.wait(60)
    assert time.monotonic() - began_s < 5.0
    assert watched.names() == ["e.tif"]
    reasons = {item.name: item.reason for item in watched.refused}
    assert sorted(reasons) == ["a.tif", "b.tif", "c.tif", "d.tif"]
    assert "is not a regular file" in reasons["b.tif"]
    assert "is not a regular file" in reasons["c.tif"]
    assert "never became complete" in reasons["a.tif"]


def test_a_read_that_does_not_return_is_named_and_others_continue(tmp_path: Path) -> None:
    go_on = threading.Event()

    def hangs(path: Path, size: int) -> bytes:
        if path.name.startswith("hangs"):
            go_on.wait()
        return read_regular(path, size)

    watched = Watched(tmp_path, FileReader(0.05, hangs)).open()
    for number in range(3):
        (tmp_path / f"hangs{number}.tif").write_bytes(image(number))
    (tmp_path / "z.tif").write_bytes(image(9))
    watched.wait(5)
    watched.takes("z.tif")
    watched.wait(25)
    assert [item.name for item in watched.refused] == ["hangs0.tif", "hangs1.tif", "hangs2.tif"]
    assert all("could not be read within 20 s" in item.reason for item in watched.refused)
    (tmp_path / "zz.tif").write_bytes(image(10))
    watched.wait(5)
    watched.takes("z.tif", "zz.tif")
    go_on.set()


def test_a_slow_read_is_taken_when_it_returns(tmp_path: Path) -> None:
    go_on = threading.Event()

    def slow(path: Path, size: int) -> bytes:
        go_on.wait()
        return read_regular(path, size)

    watched = Watched(tmp_path, FileReader(0.05, slow)).open()
    (tmp_path / "a.tif").write_bytes(image(1))
    watched.wait(5)
    assert watched.names() == []
    go_on.set()
    watched.takes("a.tif")
    assert watched.refused == []


def test_no_more_than_eight_reads_hang_at_once(tmp_path: Path) -> None:
    go_on, started = threading.Event(), list[str]()

    def hangs(path: Path, _size: int) -> bytes:
        started.append(path.name)
        go_on.wait()
        return b""

    reader = FileReader(0.01, hangs)
    for number in range(12):
        with pytest.raises(StillReading):
            reader.read(tmp_path / str(number), 1)
    wait_until(lambda: len(started) >= 8)  # a thread begins later than its reader waits where the computer is busy
    assert len(started) == 8
    go_on.set()


def test_a_file_that_holds_other_than_it_reports_is_not_taken(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    for size in (4, 6):
        with pytest.raises(OSError, match="not what can be read"):
            read_regular(path, size)
    with pytest.raises(OSError, match="not a regular file"):
        read_regular(Path("/dev/null"), 1)


def other_day(folder: Path) -> Path:
    folder.mkdir()
    for number in range(30):
        (folder / f"old{number}.tif").write_bytes(image(100 + number))
    return folder


@pytest.mark.parametrize("taken", [0, 2])
def test_another_days_folder_in_its_place_is_reported_and_nothing_is_taken_from_it(tmp_path: Path, taken: int) -> None:
    path = tmp_path / "export"
    path.mkdir()
    watched = Watched(path).open()
    for number in range(taken):
        (path / f"new{number}.tif").write_bytes(image(number))
    watched.wait(5)
    path.rename(tmp_path / "away")
    path.symlink_to(other_day(tmp_path / "other"))
    watched.wait(30)
    assert len(watched.files) == taken
    [what] = watched.replaced
    assert "another one than before, with 30 images" in what
    watched.folder.accept()
    watched.wait(5)
    (path / "late.tif").write_bytes(image(50))
    watched.wait(5)
    assert watched.names() == [*(f"new{number}.tif" for number in range(taken)), "late.tif"]
    assert watched.refused == []


def test_the_restored_folder_continues_without_a_message(tmp_path: Path) -> None:
    path = tmp_path / "export"
    path.mkdir()
    watched = Watched(path).open()
    (path / "a.tif").write_bytes(image(1))
    watched.wait(5)
    path.rename(tmp_path / "away")
    path.symlink_to(other_day(tmp_path / "other"))
    watched.wait(5)
    path.unlink()
    (tmp_path / "away").rename(path)
    (path / "b.tif").write_bytes(image(2))
    watched.wait(5)
    assert watched.names() == ["a.tif", "b.tif"]
    assert len(watched.replaced) == 1


def test_a_share_mounted_again_is_the_same_folder(tmp_path: Path) -> None:
    """Another identity, the same files and a new one."""
    path, again = tmp_path / "export", tmp_path / "again"
    path.mkdir()
    watched = Watched(path).open()
    (path / "a.tif").write_bytes(image(1))
    watched.wait(5)
    again.mkdir()
    (path / "a.tif").rename(again / "a.tif")
    (again / "b.tif").write_bytes(image(2))
    path.rmdir()
    again.rename(path)
    watched.wait(5)
    assert watched.names() == ["a.tif", "b.tif"]
    assert watched.replaced == []


def test_the_run_pauses_until_the_operator_resumes(patient: Any, tmp_path: Path) -> None:
    export = tmp_path / "export"
    terminal, operator = os.openpty()
    patient.start(operator=operator).reach("ramping")
    export.rename(tmp_path / "away")
    # Only a folder that was found missing is reported as back; on a busy computer no scan fell into the time without it.
    wait_until(lambda: any("cannot be read" in item["what"] for item in patient.logged("/fault")))
    export.symlink_to(other_day(tmp_path / "other"))
    patient.rest("paused")
    [fault] = [item for item in patient.logged("/fault") if item["code"] == "export_folder"]
    assert "another one than before" in fault["what"]
    os.write(terminal, b"resume\n")
    wait_until(lambda: patient.logged("/state")[-1]["after"] == "ramping")
    # The files that are in the folder when it is accepted do not belong to the run.
    wait_until(lambda: "the export folder is back" in patient.logged("/fault")[-1]["what"])
    pixels = np.random.default_rng(1).integers(0, 256, (64, 64), dtype=np.uint8)
    tifffile.imwrite(export / "late.tif", pixels)
    wait_until(lambda: bool(patient.logged("/sem/file")))
    assert {item["name"] for item in patient.logged("/sem/file") if item["name"]} == {"late.tif"}
    patient.daemon.terminate()
    patient.end()
    assert any(item.topic == "/sem/original" for item in messages(patient.log))
    os.close(terminal)
    os.close(operator)
