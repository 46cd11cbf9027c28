"""Files whose bytes prove that they are complete are taken at once; those that only look complete are awaited as before."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.formats import CompletenessProof, check_complete, check_finished, prove_complete
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

from .by_hand import HandClock

SCAN = dataclasses.replace(load_scenario("paper_x200").scan, width_px=32, height_px=24, frame_time_s=0.108)
ROW, BLOCK = 32, 128


def exported(vendor: Vendor, seed: int = 1, dark_rows: int = 0) -> bytes:
    image = np.random.default_rng(seed).integers(1, 256, (24, ROW), dtype=np.uint8)
    image[10 : 10 + dark_rows] = 0
    facts = ImageMetadata(SCAN, 10**18 + seed * 10**9, 0, 0, seed, "a.tif")
    return Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", vendor).encode(image, facts).image


class Watched:
    def __init__(self, path: Path) -> None:
        self.path, self.clock = path, HandClock()
        self.files: list[ExportedFile] = []
        self.refused: list[RejectedFile] = []
        self.notices: list[str] = []
        settings = WatchSettings(path, give_up_after_s=20.0)
        self.folder = ExportFolder(settings, self.clock, self.files.append, self.refused.append, print, self.notices.append)
        self.folder.open()

    def write(self, name: str, data: bytes) -> None:
        self.clock.ns += 10**7
        (self.path / name).write_bytes(data)
        os.utime(self.path / name, ns=(self.clock.ns, self.clock.ns))

    def wait(self, seconds: float) -> list[str]:
        """Scan every 25 ms; the names of all files taken so far."""
        for _ in range(round(seconds / 0.025)):
            self.folder.poll()
            self.clock.ns += 25_000_000
        return [file.name for file in self.files]


@pytest.fixture
def watched(tmp_path: Path) -> Watched:
    return Watched(tmp_path)


@pytest.mark.parametrize("vendor", [Vendor.FEI, Vendor.ZEISS, Vendor.TESCAN])
def test_a_file_with_its_header_is_taken_at_once(vendor: Vendor, watched: Watched) -> None:
    watched.write("a.tif", exported(vendor))
    assert watched.wait(0.05) == ["a.tif"]
    assert watched.files[0].data == exported(vendor)


def test_a_file_that_may_get_a_header_or_a_text_is_awaited_until_one_got_none(watched: Watched) -> None:
    watched.write("a.png", exported(Vendor.PNG))
    assert watched.wait(1.9) == []
    assert watched.wait(0.3) == ["a.png"]
    watched.write("b.png", exported(Vendor.PNG, 2))
    assert watched.wait(0.05) == ["a.png", "b.png"]
    watched.write("b.txt", b"$CM_FORMAT JEOL-SEM\r\n")
    watched.wait(0.05)
    assert len(watched.notices) == 1
    watched.write("c.png", exported(Vendor.PNG, 3))
    assert watched.wait(1.9) == ["a.png", "b.png"]
    assert watched.wait(0.3) == ["a.png", "b.png", "c.png"]


def test_rows_that_are_not_written_yet_are_awaited(watched: Watched) -> None:
    data = exported(Vendor.ZEISS)
    watched.write("a.tif", data[: -6 * ROW] + bytes(2 * ROW) + data[-4 * ROW :])
    assert watched.wait(1.9) == []
    watched.write("a.tif", data)
    assert watched.wait(0.05) == ["a.tif"]
    assert watched.files[0].data == data


def test_a_dark_frame_is_awaited_as_before(watched: Watched) -> None:
    watched.write("a.tif", exported(Vendor.FEI, dark_rows=3))
    assert watched.wait(1.9) == []
    assert watched.wait(0.3) == ["a.tif"]


def test_the_newest_file_that_is_overwritten_in_place_under_a_new_name_is_awaited(watched: Watched) -> None:
    old, new = exported(Vendor.ZEISS, 1), exported(Vendor.ZEISS, 2)
    watched.write("a.tif", old)
    watched.wait(0.05)
    for rows in (0, 1, 12, 23):  # directory and header first, then pixels
        end = len(new) - (24 - rows) * ROW
        watched.write("b.tif", new[:end] + old[end:])
        assert watched.wait(1.5) == ["a.tif"]
    watched.write("b.tif", new)
    assert watched.wait(0.05) == ["a.tif", "b.tif"]
    assert watched.files[1].data == new
    assert watched.refused == []


def test_files_are_taken_in_their_order(watched: Watched) -> None:
    watched.write("a.tif", exported(Vendor.FEI, 1, dark_rows=3))
    watched.write("b.tif", exported(Vendor.FEI, 2))
    assert watched.wait(1.9) == []
    assert watched.wait(0.3) == ["a.tif", "b.tif"]


@pytest.mark.parametrize("vendor", [Vendor.FEI, Vendor.ZEISS, Vendor.TESCAN, Vendor.TIFF])
def test_no_block_of_a_file_can_be_missing(vendor: Vendor) -> None:
    """A block of zeros anywhere in what is read is no proof, wherever it begins."""
    data = exported(vendor)

    def proof(content: bytes) -> CompletenessProof | None:
        file, profile = ExportedFile(0, "a.tif", content, "", 0, 0), ScanProfile()
        is_whole = check_complete(content) is None and check_finished(file, profile) is None
        return prove_complete(file, profile) if is_whole else None

    whole = proof(data)
    assert whole is not None
    taken: list[int] = []
    for at in range(8, len(data) - BLOCK, 16):
        found = proof(data[:at] + bytes(BLOCK) + data[at + BLOCK :])
        if found is not None and found.vendor == whole.vendor and data[at : at + BLOCK].count(0) < BLOCK // 2:
            taken.append(at)
    assert taken == []
