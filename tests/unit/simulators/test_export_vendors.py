"""Files of every vendor that the virtual SEM imitates, read by tifffile, OpenCV and rosettasciio."""

from __future__ import annotations

import io
import struct
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from rsciio.tiff import file_reader

from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

END_NS = 1_772_439_825_123_456_789
END = datetime.fromtimestamp(END_NS // 10**9, UTC)
SCAN = load_scenario("paper_x200").scan
FACTS = ImageMetadata(SCAN, END_NS, 12.5, -3.25, frame=4, name="x200_0005.tif")
IMAGE = np.random.default_rng(1).integers(0, 256, (SCAN.height_px, SCAN.width_px), dtype=np.uint8)
BAR = 60
VENDORS = list(Vendor)


def product(vendor: Vendor, image: Pixels = IMAGE) -> EncodedFrame:
    return Export(WriteStyle.DIRECT, 0.5, 1.5, 6, BAR, "x200_", vendor).encode(image, FACTS)


def read(vendor: Vendor, image: Pixels = IMAGE) -> np.ndarray:
    data = product(vendor, image).image
    if vendor is Vendor.PNG:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if vendor is Vendor.JEOL:  # libtiff undoes LZW and differences; numbers are indices of a grey palette
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)[..., 0]
    return tifffile.imread(io.BytesIO(data))


@pytest.mark.parametrize("vendor", VENDORS)
def test_pixels_come_back(vendor: Vendor) -> None:
    pixels = read(vendor)
    if vendor is Vendor.ZEISS:  # annotation in place of the last rows
        assert pixels.shape == IMAGE.shape
        assert np.array_equal(pixels[:-BAR], IMAGE[:-BAR])
        assert np.median(pixels[-BAR:]) < 30
        return
    assert pixels.shape == (IMAGE.shape[0] + BAR, IMAGE.shape[1])
    if vendor is Vendor.TESCAN:
        assert pixels.dtype == np.uint16
        assert np.array_equal(pixels[:-BAR], IMAGE.astype(np.uint16) * 257)
    else:
        assert np.array_equal(pixels[:-BAR], IMAGE)


@pytest.mark.parametrize("vendor", [vendor for vendor in VENDORS if vendor is not Vendor.JEOL])
def test_sixteen_bits_come_back(vendor: Vendor) -> None:
    deep = IMAGE.astype(np.uint16) * 251 + 7
    pixels = read(vendor, deep)
    assert pixels.dtype == np.uint16
    assert np.array_equal(pixels[: IMAGE.shape[0] - BAR], deep[:-BAR])


@pytest.mark.parametrize("vendor", VENDORS)
def test_the_same_frame_gives_the_same_files(vendor: Vendor) -> None:
    assert product(vendor) == product(vendor)


def test_zeiss_keys_and_their_traps() -> None:
    with tifffile.TiffFile(io.BytesIO(product(Vendor.ZEISS).image)) as tif:
        assert tif.is_sem
        reported = tif.sem_metadata
        page = tif.pages[0]
        twin = page.tags[34119].value  # type: ignore[union-attr]
        assert page.photometric == tifffile.PHOTOMETRIC.PALETTE  # type: ignore[union-attr]
    assert reported is not None
    assert reported["ap_line_time"] == ("Line Time", 107.09, "ms")
    assert reported["ap_frame_time"] == ("Cycle Time", 1.6, "Mins")
    assert reported["dp_dwell_time"] == ("Dwell Time", 50, "ns")
    assert reported["ap_image_pixel_size"] == ("Image Pixel Size", 1.25, "µm")
    assert reported[""][3] == pytest.approx(1.25e-6)
    assert reported["ap_date"] == ("Date", f"{END.day} {END:%b} {END.year}")
    assert reported["ap_time"] == ("Time", f"{END.hour}:{END:%M:%S}")
    assert "AP_LINE_TIME" in bytes(twin).decode("utf-16-le")


def test_zeiss_pixel_size_is_written_for_an_image_of_1024_px() -> None:
    wide = replace(SCAN, width_px=512, height_px=442, frame_time_s=47.0)
    data = Export(WriteStyle.DIRECT, 0.5, 1.5, 6, BAR, "a", Vendor.ZEISS).encode(IMAGE[:442, :512], replace(FACTS, scan=wide)).image
    with tifffile.TiffFile(io.BytesIO(data)) as tif:
        reported = tif.sem_metadata
    assert reported is not None
    assert reported["ap_pixel_size"] == ("Pixel Size", 625, "nm")
    assert reported["ap_image_pixel_size"] == ("Image Pixel Size", 1.25, "µm")
    assert reported[""][3] == pytest.approx(0.625e-6)


def test_half_a_zeiss_file_filled_with_zeros_decodes_without_error() -> None:
    data = product(Vendor.ZEISS).image
    half = data[: len(data) // 2].ljust(len(data), b"\0")
    pixels = tifffile.imread(io.BytesIO(half))
    assert pixels.shape == IMAGE.shape
    assert not pixels[-400:].any()


def test_tescan_chain_of_blocks_and_two_clocks() -> None:
    with tifffile.TiffFile(io.BytesIO(product(Vendor.TESCAN).image)) as tif:
        tags = tif.pages[0].tags  # type: ignore[union-attr]
        chain, saved = bytes(tags[50431].value), tags["DateTime"].value
    blocks: dict[int, bytes] = {}
    while chain:
        length, kind = struct.unpack_from("<IH", chain)
        blocks[kind] = chain[6 : 4 + length]
        chain = chain[4 + length :]
    assert sorted(blocks) == [0, 1, 2, 3]
    assert cv2.imdecode(np.frombuffer(blocks[1], np.uint8), cv2.IMREAD_UNCHANGED).shape == (128, 148)
    reported = dict(line.split("=", 1) for line in (blocks[2] + blocks[3]).decode("cp1252").splitlines())
    assert (reported["PixelSizeX"], reported["PixelSizeY"], reported["DwellTime"]) == ("1.2500e-6", "1.2500e-6", "100.00e-6")
    assert reported["ImageStripSize"] == "60"
    assert reported["AccFrames"] == "1"
    assert f"{reported['Date']} {reported['Time']}" == f"{END:%Y-%m-%d %H:%M:%S}"
    later = datetime.strptime(saved, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    assert (later - END).total_seconds() == 11


def test_jeol_is_compressed_and_its_sidecar_reports_the_size_without_bar() -> None:
    made = product(Vendor.JEOL)
    with tifffile.TiffFile(io.BytesIO(made.image)) as tif:
        assert tif.pages[0].compression == tifffile.COMPRESSION.LZW  # type: ignore[union-attr]
        assert tif.pages[0].tags[317].value == 2  # type: ignore[union-attr]
    assert made.sidecar is not None
    reported = dict((*line.split(" ", 1), "")[:2] for line in made.sidecar.decode("cp1252").splitlines())
    assert reported["$CM_FULL_SIZE"] == "1024 884"
    assert (reported["$$SM_MICRON_BAR"], reported["$$SM_MICRON_MARKER"]) == ("160", "200um")
    assert (reported["$CM_DATE"], reported["$CM_TIME"]) == (f"{END:%Y/%m/%d}", f"{END:%H:%M:%S}")


def test_hitachi_sidecar_has_the_day_first_and_counts_the_bar() -> None:
    sidecar = product(Vendor.HITACHI).sidecar
    assert sidecar is not None
    head, *lines = sidecar.decode("cp1252").splitlines()
    assert head == "[SemImageFile]"
    reported = dict(line.split("=", 1) for line in lines)
    assert reported["DataSize"] == "1024x944"
    assert float(reported["PixelSize"]) == 1250
    assert reported["ImageName"] == "x200_0005.tif"
    assert (reported["Date"], reported["Time"]) == (f"{END:%d/%m/%Y}", f"{END:%H:%M:%S}")


def test_integration_is_written_as_each_vendor_does() -> None:
    export = Export(WriteStyle.DIRECT, 0.5, 1.5, 6, 0, "a", Vendor.FEI)
    lines = replace(FACTS, scan=replace(SCAN, integrations=4, integration="line"))
    frames = replace(FACTS, scan=replace(SCAN, integrations=16, integration="frame"))
    reported = {}
    for name, facts in (("lines", lines), ("frames", frames)):
        with tifffile.TiffFile(io.BytesIO(export.encode(IMAGE, facts).image)) as tif:
            fei = tif.fei_metadata
        with tifffile.TiffFile(io.BytesIO(replace(export, vendor=Vendor.ZEISS).encode(IMAGE, facts).image)) as tif:
            zeiss = tif.sem_metadata
        assert fei is not None
        assert zeiss is not None
        reported[name] = fei, zeiss
    fei, zeiss = reported["lines"]
    assert (fei["EScan"]["LineIntegration"], fei["Image"]["Integrate"]) == (4, 1)
    assert fei["EScan"]["LineTime"] == 4 * SCAN.row_time_s  # all passes, but the dwell of one
    assert fei["EScan"]["Dwell"] == SCAN.dwell_time_s
    assert zeiss["ap_line_time"] == ("Line Time", 428.37, "ms")
    assert zeiss["ap_line_average_count"] == ("Line Avg.Count", 4)
    fei, zeiss = reported["frames"]
    assert (fei["EScan"]["LineIntegration"], fei["Image"]["Integrate"]) == (1, 16)
    assert fei["EScan"]["FrameTime"] == SCAN.frame_time_s
    assert zeiss["ap_frame_int_count"] == ("Frames to Int.", 16)


@pytest.mark.parametrize("vendor", [Vendor.FEI, Vendor.ZEISS])
def test_rosettasciio_reads_pixel_size_and_date(vendor: Vendor, tmp_path: Path) -> None:
    path = tmp_path / "frame.tif"
    path.write_bytes(product(vendor).image)
    [signal] = file_reader(str(path))
    assert [axis["scale"] for axis in signal["axes"]] == pytest.approx([1.25e-6, 1.25e-6], rel=1e-6)
    assert {axis["units"] for axis in signal["axes"]} == {"m"}
    mapped = {}
    for key, (target, convert) in signal["mapping"].items():
        value = signal["original_metadata"]
        for part in key.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        if value is not None:
            mapped[target] = convert(value) if convert else value
    assert mapped["General.date"] == f"{END:%Y-%m-%d}"
    assert mapped["General.time"].startswith(f"{END:%H:%M:%S}")


def test_rosettasciio_reads_the_date_of_saving_in_a_tescan_file(tmp_path: Path) -> None:
    path = tmp_path / "frame.tif"
    path.write_bytes(product(Vendor.TESCAN).image)
    [signal] = file_reader(str(path))
    assert signal["metadata"]["General"]["date"] == f"{END:%Y-%m-%d}"
    assert signal["data"].shape == (944, 1024)
