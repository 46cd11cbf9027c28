"""Files in the export folder that a run does not take are reported once for each kind; text files are found in any letter case."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest

from semlive.data.frame import ExportedFile
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.sidecars import sidecar_of
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings

from .by_hand import HandClock, image

TESCAN = (
    b"[MAIN]\r\nAccFrames=1\r\nDate=2023-03-14\r\nTime=10:11:12\r\nDevice=MIRA3\r\nPixelSizeX=1.36e-7\r\nPixelSizeY=1.36e-7\r\n"
    b"[SEM]\r\nDwellTime=3.2e-06\r\nImageStripSize=4\r\n"
)


@dataclass
class Watched:
    """A watched folder and everything that was reported about it."""

    path: Path
    vendor: str | None = None
    clock: HandClock = field(default_factory=HandClock)
    files: list[ExportedFile] = field(default_factory=list)
    refused: list[RejectedFile] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)

    def open(self) -> Watched:
        settings = WatchSettings(self.path, stable_for_s=2.0, give_up_after_s=20.0, vendor=self.vendor)
        self.folder = ExportFolder(settings, self.clock, self.files.append, self.refused.append, self.notices.append, self.notices.append)
        self.folder.open()
        return self

    def wait(self, seconds: int = 5) -> None:
        for _ in range(seconds):
            self.folder.poll()
            self.clock.ns += 10**9
        self.folder.poll()


def test_the_first_file_of_each_kind_is_reported(tmp_path: Path) -> None:
    (tmp_path / "2026-11-26").mkdir()
    (tmp_path / "old.jpg").write_bytes(b"old")
    watched = Watched(tmp_path).open()
    watched.wait()
    assert watched.notices == []
    for name in ("a_001.jpg", "a_002.jpg", "a_001.BMP", "a_001.xyz", "a_001.txt", "thumbs.db", ".hidden.gif", "a.tif.part"):
        (tmp_path / name).write_bytes(b"x" * 1000)
    (tmp_path / "2026-11-26" / "s_001.tif").write_bytes(image(1))
    (tmp_path / "2026-11-27" / "morning").mkdir(parents=True)
    watched.wait()
    (tmp_path / "2026-11-27" / "morning" / "s_002.tif").write_bytes(image(2))
    watched.wait()
    assert sorted(notice.split(":")[0].split(".")[-1] for notice in watched.notices) == ["BMP", "jpg", "tif", "xyz"]
    shown = "\n".join(watched.notices)
    assert (
        "a_001.jpg: is not taken, because a run takes .tif, .tiff, .png only; set the SEM's export to TIFF" in shown or "a_002.jpg" in shown
    )
    assert "2026-11-26/s_001.tif: is not taken, because a run does not look into folders inside the export folder" in shown
    assert (watched.files, watched.refused) == ([], [])


def test_a_new_folder_of_the_day_is_reported(tmp_path: Path) -> None:
    watched = Watched(tmp_path).open()
    (tmp_path / "2026" / "11").mkdir(parents=True)
    (tmp_path / "2026" / "11" / "a.png").write_bytes(b"x")
    watched.wait()
    [notice] = watched.notices
    assert notice.startswith("2026/11/a.png: is not taken")


@pytest.mark.parametrize("name", ["a-tif.HDR", "A-TIF.hdr", "A.Hdr", "a.HDR"])
def test_a_text_file_is_found_in_any_letter_case(tmp_path: Path, name: str) -> None:
    (tmp_path / "b.txt").write_bytes(b"another")
    watched = Watched(tmp_path, "tescan").open()
    (tmp_path / "a.tif").write_bytes(image(1))
    (tmp_path / name).write_bytes(TESCAN)
    watched.wait()
    [file] = watched.files
    assert file.sidecar == TESCAN
    assert sidecar_of(tmp_path / "a.tif") == tmp_path / name


def test_the_exact_name_has_precedence(tmp_path: Path) -> None:
    for name in ("a.tif", "A.TXT", "a.txt"):
        (tmp_path / name).write_bytes(name.encode())
    assert sidecar_of(tmp_path / "a.tif") == tmp_path / "a.txt"
    assert sidecar_of(tmp_path / "b.tif") is None
