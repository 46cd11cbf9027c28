"""Files damaged by a microscope, a share or a user: sidecar texts, zeros, headers that come last, names that count backwards."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench_watch import measure

from semlive.data.settings import ScanProfile
from semlive.service.watch.accepted_files import FileNumbering
from semlive.service.watch.sidecars import sidecar_names
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

from .by_hand import Watched

SCAN = dataclasses.replace(load_scenario("paper_x200").scan, width_px=32, height_px=24, frame_time_s=0.108)


def made(vendor: Vendor, seed: int = 1, bar: int = 0) -> EncodedFrame:
    image = np.random.default_rng(seed).integers(1, 256, (24, 32), dtype=np.uint8)
    return Export(WriteStyle.DIRECT, 0.0, 1.0, 1, bar, "x", vendor).encode(
        image, ImageMetadata(SCAN, 10**18 + seed * 10**9, 0, 0, seed, "a.tif")
    )


@pytest.fixture
def watched(tmp_path: Path) -> Callable[..., Watched]:
    return lambda **settings: Watched(tmp_path, **settings)


def test_every_pattern_of_arrival_gets_its_verdict_once(tmp_path: Path) -> None:
    figures = measure(160, 2, tmp_path)
    assert figures["first_wrong"] == []
    assert int(str(figures["files"])) >= 160


def test_an_image_waits_for_the_text_that_its_vendor_writes(watched: Callable[..., Watched]) -> None:
    folder, product = watched(vendor="jeol"), made(Vendor.JEOL)
    folder.write("a.tif", product.image)
    folder.wait(10)
    assert folder.files == []
    folder.write("a.txt", product.sidecar or b"")
    folder.wait(4)
    assert [(file.data, file.sidecar) for file in folder.files] == [(product.image, product.sidecar)]


def test_an_image_whose_text_never_comes_is_refused_and_taken_when_it_does(watched: Callable[..., Watched]) -> None:
    folder, product = watched(vendor="hitachi", sidecar_timeout_s=30.0), made(Vendor.HITACHI)
    folder.write("a.tif", product.image)
    folder.wait(60)
    assert [one.reason for one in folder.refused] == [
        "a.tif: never got the text file that hitachi writes for it; "
        "switch the export of image information on, or raise sem.sidecar_timeout_s."
    ]
    folder.write("a.txt", product.sidecar or b"")
    folder.wait(5)
    assert len(folder.files) == 1


def test_a_text_that_comes_too_late_is_reported(watched: Callable[..., Watched]) -> None:
    folder, product = watched(), made(Vendor.JEOL)
    folder.write("a.tif", product.image)
    folder.wait(5)
    folder.write("a.txt", product.sidecar or b"")
    folder.wait(5)
    assert folder.files[0].sidecar is None
    [notice] = folder.notices
    assert "a.txt came after a.tif was taken as export 0 without it; name the SEM in sem.vendor" in notice


def test_a_file_without_the_header_of_its_vendor_is_not_complete(watched: Callable[..., Watched]) -> None:
    folder = watched(vendor="fei")
    folder.write("a.tif", made(Vendor.TIFF).image)
    folder.wait(40)
    assert "never became complete (it has no header of fei)" in folder.refused[0].reason
    folder.write("b.tif", made(Vendor.FEI).image)
    folder.wait(4)
    assert [file.name for file in folder.files] == ["b.tif"]


def test_zeros_above_a_databar_are_no_finished_rows(watched: Callable[..., Watched]) -> None:
    folder, data = watched(profile=ScanProfile(databar_rows=4)), bytearray(made(Vendor.ZEISS).image)
    data[-8 * 32 : -4 * 32] = bytes(4 * 32)  # directory first, so that pixels end the file
    folder.write("a.tif", bytes(data))
    folder.wait(40)
    assert "its last 4 rows are zero" in folder.refused[0].reason


def test_a_text_that_ends_in_zeros_has_time_to_be_written_but_is_taken_in_the_end(watched: Callable[..., Watched]) -> None:
    folder, data = watched(), made(Vendor.FEI).image
    folder.write("a.tif", data[:-300].ljust(len(data), b"\0"))
    folder.wait(15)
    assert folder.files == []
    folder.wait(15)
    assert len(folder.files) == 1
    assert folder.refused == []


def test_a_share_that_comes_back_with_an_old_list_costs_nothing(watched: Callable[..., Watched], tmp_path: Path) -> None:
    folder = watched()
    folder.write("a.tif", made(Vendor.FEI).image)
    folder.wait(1)
    hidden = tmp_path / ".a.tif"
    (tmp_path / "a.tif").rename(hidden)  # not in the list for a moment
    folder.wait(1)
    hidden.rename(tmp_path / "a.tif")
    folder.wait(5)
    assert len(folder.files) == 1
    assert folder.refused == []


def test_missing_and_decreasing_numbers_are_reported(watched: Callable[..., Watched]) -> None:
    folder = watched()
    for seed, name in enumerate(("x_0001.tif", "x_0002.tif", "x_0005.tif", "x_0003.tif", "other.tif")):
        folder.write(name, made(Vendor.FEI, seed).image)
        folder.wait(4)
    assert [file.name for file in folder.files] == ["x_0001.tif", "x_0002.tif", "x_0005.tif", "x_0003.tif", "other.tif"]
    assert [notice.split(";")[0] for notice in folder.notices] == [
        "x_0005.tif came after x_0002.tif: 2 numbers are missing in between",
        "x_0003.tif came after x_0005.tif: the SEM's count of file names went back",
    ]


def test_each_kind_of_name_counts_for_itself() -> None:
    names = FileNumbering()
    assert [names.check_gap(name) for name in ("a_1.tif", "b_7.tif", "a_2.tif", "b_8.tif", "scan.tif")] == [None] * 5


def test_texts_are_found_under_every_name_that_vendors_give_them() -> None:
    assert sidecar_names("a.b.tif") == ("a.b.txt", "a.b.TXT", "a.b-tif.hdr", "a.b.hdr")
    assert sidecar_names("tif") == ()


def test_only_a_file_observed_at_its_arrival_gives_clock_offsets(watched: Callable[..., Watched]) -> None:
    folder = watched()
    folder.write("a.tif", made(Vendor.FEI, 1).image)  # before the first look
    folder.wait(4)
    folder.write("b.tif", made(Vendor.FEI, 2).image)
    came_ns = folder.clock.ns
    folder.wait(4)
    assert [file.stable_time_ns for file in folder.files] == [0, came_ns]
