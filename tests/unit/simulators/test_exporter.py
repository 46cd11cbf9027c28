"""Files of the virtual SEM, read by tifffile."""

from __future__ import annotations

import io
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

import numpy as np
import pytest
import tifffile

from semlive_simulators.exporters.fei import encode_tiff
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.scenario import load_scenario

END_NS = 1_772_439_825_123_456_789
SCAN = load_scenario("paper_x200").scan
FACTS = ImageMetadata(SCAN, END_NS, 12.5, -3.25, frame=4)
IMAGE = np.random.default_rng(1).integers(0, 256, (SCAN.height_px, SCAN.width_px), dtype=np.uint8)
DATA = encode_tiff(IMAGE, FACTS, databar_rows=60)


def test_pixels_come_back_with_a_databar_below() -> None:
    pixels = tifffile.imread(io.BytesIO(DATA))
    assert pixels.dtype == np.uint8
    assert pixels.shape == (884 + 60, 1024)
    assert np.array_equal(pixels[:884], IMAGE)
    bar = pixels[884:]
    assert np.median(bar) < 30
    assert 0.01 < (bar > 150).mean() < 0.3


def test_fei_tags_hold_timing_and_size() -> None:
    with tifffile.TiffFile(io.BytesIO(DATA)) as tif:
        assert tif.is_fei
        fei = tif.fei_metadata
        xml = tif.pages[0].tags[34683].value  # type: ignore[union-attr]
    assert fei is not None
    assert fei["EScan"]["LineTime"] == 94.67 / 884
    assert fei["EScan"]["FrameTime"] == fei["Scan"]["FrameTime"] == 94.67
    assert fei["EScan"]["Dwell"] == fei["Scan"]["Dwelltime"] == 1e-4
    assert fei["EScan"]["PixelWidth"] == pytest.approx(1.25e-6, rel=1e-12)
    assert (fei["Image"]["ResolutionX"], fei["Image"]["ResolutionY"], fei["Image"]["Integrate"]) == (1024, 884, 1)
    assert fei["PrivateFei"]["DatabarHeight"] == 60
    end = datetime.fromtimestamp(END_NS // 10**9, UTC)
    assert fei["User"]["Date"] == f"{end:%m/%d/%Y}"
    assert fei["User"]["Time"] == f"{end:%I:%M:%S %p}"
    assert fei["PrivateFei"]["TimeOfCreation"] == f"{end:%d.%m.%Y %H:%M:%S}"
    root = ElementTree.fromstring(xml)
    stamp = datetime.fromisoformat(root.findtext("Acquisition/AcquisitionDatetime") or "").replace(tzinfo=UTC)
    assert (stamp - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) == END_NS // 1000
    assert float(root.findtext("ScanSettings/LineTime") or 0) == 94.67 / 884


def test_the_directory_is_behind_the_pixels_so_that_half_a_file_cannot_be_read() -> None:
    for part in (0.2, 0.9):
        with pytest.raises((tifffile.TiffFileError, IndexError)), tifffile.TiffFile(io.BytesIO(DATA[: int(part * len(DATA))])) as tif:
            tif.pages[0].asarray()


def test_the_same_frame_gives_the_same_bytes() -> None:
    assert encode_tiff(IMAGE, FACTS, databar_rows=60) == DATA


def test_fei_reports_integrated_frames_and_where_the_beam_is() -> None:
    scan = replace(SCAN, integrations=16, rotation_rad=0.1)
    facts = replace(FACTS, scan=scan, beam_x_um=0.25, beam_y_um=-0.5)
    with tifffile.TiffFile(io.BytesIO(encode_tiff(IMAGE, facts, databar_rows=60))) as tif:
        fei = tif.fei_metadata
    assert fei is not None
    assert (fei["Image"]["Integrate"], fei["Scan"]["Integrate"]) == (16, 1)  # as a Quanta writes it: they can differ
    assert fei["EScan"]["FrameTime"] == 94.67  # of one scan
    assert fei["Beam"]["BeamShiftX"] == pytest.approx(2.5e-7)
    assert fei["Beam"]["BeamShiftY"] == pytest.approx(-5e-7)
    assert fei["Beam"]["ScanRotation"] == pytest.approx(0.1)
