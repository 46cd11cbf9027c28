"""Row starts of an instrument's own clock that are written after their image: awaited, bounded, and reported where they never come."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from semlive.data.scan import RowClock
from semlive.data.settings import ScanProfile
from semlive.errors import BadConfig
from semlive.formats import read_info
from semlive.service.config.configuration import parse_config
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

from .by_hand import Watched

SCAN = dataclasses.replace(load_scenario("paper_x200").scan, width_px=32, height_px=24, frame_time_s=0.108)
STARTS_S = tuple((0.0045 * np.arange(24) + np.where(np.arange(24) > 11, 3.0, 0.0)).tolist())
"""A pause of 3 s after row 11."""
PROFILE = ScanProfile(dwell_time_s=1e-4, row_time_s=4.5e-3, pixel_size_m=1e-7)


def made(seed: int, vendor: Vendor = Vendor.TIFF) -> EncodedFrame:
    """An image and the text file with its row starts."""
    image = np.random.default_rng(seed).integers(1, 256, (24, 32), dtype=np.uint8)
    facts = ImageMetadata(SCAN, 10**18 + seed * 10**9, 0, 0, seed, "a.tif", row_start_s=STARTS_S)
    return Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", vendor, row_clock=True).encode(image, facts)


@pytest.fixture
def watched(tmp_path: Path) -> Callable[[str], Watched]:
    return lambda row_clock: Watched(tmp_path, row_clock=row_clock, sidecar_timeout_s=30.0, profile=PROFILE)


@pytest.mark.parametrize("row_clock", ["awaited", "required"])
@pytest.mark.parametrize("vendor", [Vendor.TIFF, Vendor.FEI, Vendor.PNG])
def test_an_image_waits_for_its_row_starts(watched: Callable[[str], Watched], row_clock: str, vendor: Vendor) -> None:
    folder, product = watched(row_clock), made(1, vendor)
    name = "a.png" if vendor is Vendor.PNG else "a.tif"
    folder.write(name, product.image)
    folder.wait(10)
    assert folder.files == []
    folder.write("a.txt", product.sidecar or b"")
    folder.wait(4)
    [file] = folder.files
    assert read_info(file, PROFILE).timing.clock == RowClock(STARTS_S)
    assert (folder.refused, folder.notices) == ([], [])


def test_row_starts_that_are_still_written_are_awaited(watched: Callable[[str], Watched]) -> None:
    folder, product = watched("required"), made(1)
    assert product.sidecar is not None
    folder.write("a.tif", product.image)
    folder.write("a.txt", b"")
    folder.wait(5)
    folder.write("a.txt", product.sidecar[: len(product.sidecar) // 2])
    folder.wait(5)
    assert folder.files == []
    folder.write("a.txt", product.sidecar)
    folder.wait(5)
    assert [file.sidecar for file in folder.files] == [product.sidecar]
    folder.write("b.tif", made(2).image)
    folder.write("b.txt", product.sidecar[: len(product.sidecar) // 2])
    folder.wait(30)
    assert "b.tif: never became complete (the text file of b.tif: holds 1" in folder.refused[0].reason
    assert "and the frame has 24" in folder.refused[0].reason


def test_an_image_without_required_row_starts_is_refused_until_they_come(watched: Callable[[str], Watched]) -> None:
    folder, product = watched("required"), made(1)
    folder.write("a.tif", product.image)
    folder.wait(40)
    assert [one.reason for one in folder.refused] == [
        "a.tif: never got a text file with row_start_s, which sem.row_clock requires; "
        "check the export of the clock, raise sem.sidecar_timeout_s, or set sem.row_clock to awaited."
    ]
    folder.write("a.txt", product.sidecar or b"")
    folder.wait(5)
    assert len(folder.files) == 1


@pytest.mark.parametrize(("text", "why"), [(None, "never got a text file with"), (b"Magnification = 200\n", "has a text file without")])
def test_an_image_is_used_without_row_starts_where_the_configuration_allows_it(
    watched: Callable[[str], Watched], text: bytes | None, why: str
) -> None:
    folder = watched("awaited")
    folder.write("a.tif", made(1).image)
    if text is not None:
        folder.write("a.txt", text)
    folder.wait(25)
    assert folder.files == []
    folder.wait(15)
    assert [read_info(file, PROFILE).timing.clock for file in folder.files] == [None]
    assert folder.notices == [f"a.tif: {why} row_start_s, so equations 1 to 4 give its times."]
    folder.write("a.txt", made(1).sidecar or b"")
    folder.wait(3)
    assert (len(folder.files), folder.refused) == (1, [])
    late = "a.txt came after a.tif was taken as export 0 without it; raise sem.sidecar_timeout_s."
    assert folder.notices[1:] == ([late] if text is None else [])


def test_a_later_image_does_not_overtake_one_that_waits(watched: Callable[[str], Watched]) -> None:
    folder = watched("awaited")
    folder.write("a.tif", made(1).image)
    folder.wait(5)
    folder.write("b.txt", made(2).sidecar or b"")
    folder.write("b.tif", made(2).image)
    folder.wait(10)
    assert folder.files == []
    folder.wait(25)
    assert [file.name for file in folder.files] == ["a.tif", "b.tif"]


def test_the_text_file_of_a_vendor_is_no_row_clock(tmp_path: Path) -> None:
    config = {"sem": {"folder": str(tmp_path), "pixel_size_um": 0.1, "vendor": "jeol", "row_clock": "required"}, "protocol": {}}
    with pytest.raises(BadConfig, match="row_clock must be if_present, because the text file of an image is that of jeol"):
        parse_config(config, "config")
