"""A file that another program still has open: it is waited for and never refused for that. The report of Windows is emulated elsewhere."""

from __future__ import annotations

import errno
import sys
from dataclasses import dataclass, field
from pathlib import Path

from semlive.data.frame import ExportedFile
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.file_locks import is_locked_error, open_elsewhere
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings

from .by_hand import HandClock, image


@dataclass
class Watched:
    """A folder whose system reports who has which file open."""

    path: Path
    held: set[str] = field(default_factory=set)
    clock: HandClock = field(default_factory=HandClock)
    files: list[ExportedFile] = field(default_factory=list)
    refused: list[RejectedFile] = field(default_factory=list)
    reports: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        settings = WatchSettings(self.path, stable_for_s=2.0, give_up_after_s=20.0)
        reports = self.reports.append
        self.folder = ExportFolder(
            settings, self.clock, self.files.append, self.refused.append, reports, reports, lambda path: path.name in self.held
        )
        self.folder.open()

    def wait(self, seconds: int) -> None:
        for _ in range(seconds):
            self.folder.poll()
            self.clock.ns += 10**9
        self.folder.poll()


def test_a_complete_file_is_not_taken_while_its_writer_has_it_open(tmp_path: Path) -> None:
    item = Watched(tmp_path, {"a.tif"})
    (tmp_path / "a.tif").write_bytes(image(1))
    item.wait(100)
    assert (item.files, item.refused) == ([], [])
    (notice,) = item.reports
    assert notice.startswith("a.tif: another program has had it open for 2")
    assert notice.endswith("it is taken when that lets go of it.")
    item.held.clear()
    item.wait(6)
    assert [file.data for file in item.files] == [image(1)]
    assert item.refused == []


def test_a_file_that_the_system_reports_as_open_is_recognised() -> None:
    assert is_locked_error(OSError(errno.EBUSY, "busy"))
    assert is_locked_error(OSError(errno.ETXTBSY, "text file busy"))
    assert not is_locked_error(OSError(errno.EACCES, "permission denied"))
    refused = OSError(errno.EACCES, "the process cannot access the file")
    for number, held in ((32, True), (33, True), (5, False)):
        refused.winerror = number  # type: ignore[attr-defined]  # as Windows sets it
        assert is_locked_error(refused) is held


def test_what_this_system_reports_of_an_open_file(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with path.open("wb") as file:
        file.write(image(1))
        file.flush()
        assert open_elsewhere(path) is (sys.platform == "win32")
    assert not open_elsewhere(path)
    assert not open_elsewhere(tmp_path / "none.tif")
