"""Exported files of known content: what is read, where it comes from, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from io import BytesIO

import cv2
import numpy as np
import pytest
import tifffile

from semlive.data.frame import ExportedFile
from semlive.data.scan import Provenance
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats import check_complete, read_frame, read_info

INI = """[User]
Date=11/10/2023
Time=02:09:15 PM
[Beam]
Beam=EBeam
Scan=EScan
[Scan]
Dwelltime=1e-005
Integrate=1
FrameTime={frame}
[EScan]
Dwell=1e-005
PixelWidth=2.5e-008
PixelHeight=2.5e-008
FrameTime={frame}
LineTime={line}
LineIntegration={passes}
ScanInterlacing=1
[Image]
Average={average}
Integrate={integrate}
ResolutionX={width}
ResolutionY={height}
DriftCorrected={corrected}
[PrivateFei]
TimeOfCreation=10.11.2023 14:09:15
DatabarHeight=0
"""
XML = """<?xml version="1.0"?>
<Metadata xmlns="http://schemas.fei.com/Metadata/v1/2013/07"><Acquisition>
<AcquisitionDatetime>{time}</AcquisitionDatetime></Acquisition></Metadata>"""
SETTINGS = {
    "frame": "0.0612",
    "line": "0.00102",
    "passes": "1",
    "average": "0",
    "integrate": "1",
    "width": "64",
    "height": "56",
    "corrected": "Off",
}
CREATED = datetime(2023, 11, 10, 14, 9, 15, tzinfo=UTC)
PLAIN = ScanProfile(dwell_time_s=1e-5, row_time_s=1e-3, pixel_size_m=1e-8, start_sigma_s=0.5)
MTIME_NS = 1_700_000_000_000_000_000


def speckle(rows: int = 60, columns: int = 64, dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (rows, columns), dtype=dtype, endpoint=True)


def exported(data: bytes, name: str = "img_001.tif") -> ExportedFile:
    return ExportedFile(7, name, data, "", MTIME_NS, MTIME_NS)


def tiff_bytes(image: np.ndarray, tags: tuple = (), **options: object) -> bytes:
    stream = BytesIO()
    tifffile.imwrite(stream, image, extratags=tags, metadata=None, **options)  # type: ignore[arg-type]
    return stream.getvalue()


def fei_bytes(image: np.ndarray | None = None, xml_time: str | None = None, ini: str = INI, **settings: str) -> bytes:
    image = speckle() if image is None else image
    tags = [(34682, 2, 0, ini.format(**SETTINGS | settings), True)]
    if xml_time is not None:
        tags.append((34683, 2, 0, XML.format(time=xml_time), True))
    return tiff_bytes(image, tuple(tags))


def png_bytes(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def ns(instant: datetime) -> int:
    return int(instant.timestamp()) * 10**9


def test_fei_frame_is_cropped_and_every_value_comes_from_the_file() -> None:
    frame = read_frame(exported(fei_bytes()), ScanProfile())
    info = frame.info
    assert np.array_equal(frame.image, speckle()[:56])
    assert (info.export, info.vendor, info.width_px, info.height_px, info.databar_rows) == (7, "fei", 64, 56, 4)
    assert info.timing.dwell_time_s.value == 1e-5
    assert info.timing.row_time_s.value == 1.02e-3  # LineTime, not 64 x 1e-5
    assert info.timing.frame_time_s.value == 0.0612
    assert info.pixel_size_m.value == 2.5e-8
    sources = {v.source for v in (info.timing.dwell_time_s, info.timing.row_time_s, info.timing.frame_time_s, info.pixel_size_m)}
    assert sources == {Provenance.FILE}
    assert not frame.image.flags.writeable


def test_sixteen_bits_stay_sixteen_bits() -> None:
    image = speckle(dtype=np.uint16)
    frame = read_frame(exported(fei_bytes(image)), ScanProfile())
    assert frame.image.dtype == np.uint16
    assert np.array_equal(frame.image, image[:56])


def test_a_start_in_integer_seconds_is_the_middle_of_the_second_less_the_scan() -> None:
    info = read_info(exported(fei_bytes()), ScanProfile(start_anchor="end", start_sigma_s=0.01))
    assert info.start_time_ns.value == ns(CREATED) + 500_000_000 - 61_200_000
    assert info.start_time_ns.source is Provenance.DERIVED
    assert info.start_sigma_s == pytest.approx(12**-0.5)
    assert info.end_time_ns == ns(CREATED) + 500_000_000


def test_fractional_seconds_of_the_xml_are_preferred() -> None:
    data = fei_bytes(xml_time="2023-11-10T14:09:15.123456")
    info = read_info(exported(data), ScanProfile(start_anchor="start", start_sigma_s=0.01))
    assert info.start_time_ns.value == ns(CREATED) + 123_456_000
    assert info.start_time_ns.source is Provenance.FILE
    assert info.start_sigma_s == 0.01


def test_a_named_zone_is_honoured() -> None:
    info = read_info(exported(fei_bytes(xml_time="2023-11-10T15:09:15.5+01:00")), ScanProfile(start_anchor="start"))
    assert info.start_time_ns.value == ns(CREATED) + 500_000_000


def test_user_date_serves_when_there_is_no_time_of_creation() -> None:
    ini = INI.replace("TimeOfCreation=10.11.2023 14:09:15", "TimeOfCreation=")
    info = read_info(exported(fei_bytes(ini=ini)), ScanProfile(start_anchor="start"))
    assert info.start_time_ns.value == ns(CREATED) + 500_000_000


def test_integrated_frames_prolong_the_scan() -> None:
    info = read_info(exported(fei_bytes(integrate="5")), ScanProfile())
    assert info.timing.integrations.value == 5
    assert info.timing.duration_s == pytest.approx(5 * 0.0612)


def test_missing_values_come_from_the_profile_with_that_source() -> None:
    ini = INI.replace("LineTime={line}\n", "")
    with pytest.raises(BadImage, match=r"row time; set sem\.profile\.row_time_s"):
        read_info(exported(fei_bytes(ini=ini)), ScanProfile())
    info = read_info(exported(fei_bytes(ini=ini)), ScanProfile(row_time_s=1.02e-3))
    assert info.timing.row_time_s.source is Provenance.CONFIG


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"corrected": "On"}, "DriftCorrected=On"),
        ({"average": "4"}, "running average"),
        ({"line": "0.0006"}, "row time of 0.0006 s is shorter"),
        ({"passes": "2"}, "shorter than 2 x 64 px"),
        ({"frame": "0.05"}, "frame time of 0.05 s is shorter"),
        ({"width": "128"}, "64 px wide but its header contains 128"),
        ({"height": "61"}, "60 rows but its header contains 61"),
    ],
)
def test_contradictions_and_processed_frames_are_refused(settings: dict[str, str], sentence: str) -> None:
    with pytest.raises(BadImage, match=sentence):
        read_info(exported(fei_bytes(**settings)), ScanProfile())


def test_header_appended_as_text_is_found() -> None:
    data = tiff_bytes(speckle()) + INI.format(**SETTINGS).replace("\n", "\r\n").encode()
    assert read_info(exported(data), ScanProfile()).vendor == "fei"


def test_plain_files_need_the_profile_and_end_at_their_modification_time() -> None:
    for data in (png_bytes(speckle()), tiff_bytes(speckle())):
        with pytest.raises(BadImage, match=r"set sem\.profile\.dwell_time_s, sem\.profile\.row_time_s, sem\.profile\.pixel_size_m"):
            read_info(exported(data), ScanProfile())
        frame = read_frame(exported(data), replace(PLAIN, databar_rows=10))
        assert np.array_equal(frame.image, speckle()[:50])
        assert frame.info.vendor == "plain"
        assert frame.info.start_time_ns.value == MTIME_NS - 50_000_000
        assert frame.info.timing.frame_time_s.source is Provenance.DERIVED
        assert frame.info.start_sigma_s == 0.5


def test_grey_in_disguise_is_read_and_colours_are_refused() -> None:
    grey = speckle()
    for data in (
        tiff_bytes(np.stack([grey] * 3, axis=2), photometric="rgb"),
        tiff_bytes(np.iinfo(np.uint8).max - grey, photometric="miniswhite"),
        tiff_bytes(np.stack([grey] * 3), photometric="rgb", planarconfig="separate"),
        png_bytes(np.stack([grey] * 3, axis=2)),
    ):
        assert np.array_equal(read_frame(exported(data), PLAIN).image, grey)
    colours = np.random.default_rng(2).integers(0, 255, (60, 64, 3), dtype=np.uint8)
    for data in (tiff_bytes(colours, photometric="rgb"), png_bytes(colours)):
        with pytest.raises(BadImage, match="colour"):
            read_frame(exported(data), PLAIN)


def test_images_that_are_no_finished_scan_are_refused() -> None:
    half = speckle()
    half[40:] = 0
    with pytest.raises(BadImage, match="last 20 rows are uniform"):
        read_frame(exported(tiff_bytes(half)), PLAIN)
    with pytest.raises(BadImage, match="every pixel is 9"):
        read_frame(exported(tiff_bytes(np.full((60, 64), 9, np.uint8))), PLAIN)


def test_float_images_and_strange_files_are_refused() -> None:
    with pytest.raises(BadImage, match="32"):
        read_frame(exported(tiff_bytes(speckle().astype(np.float32))), PLAIN)
    for data in (b"", b"II*\0", b"\x89PNG\r\n\x1a\n", b"hello, world"):
        with pytest.raises(BadImage, match=r"img_001\.tif"):
            read_frame(exported(data), PLAIN)
        assert check_complete(data) is not None


def test_a_header_that_declares_too_much_is_refused_before_any_memory_is_taken() -> None:
    png = bytearray(png_bytes(speckle()))
    png[16:24] = (60_000).to_bytes(4, "big") * 2
    with pytest.raises(BadImage, match="more than is read"):
        read_frame(exported(bytes(png)), PLAIN)


def test_every_truncation_of_a_file_is_recognised_as_incomplete() -> None:
    for data in (fei_bytes(xml_time="2023-11-10T14:09:15"), png_bytes(speckle())):
        assert check_complete(data) is None
        assert all(check_complete(data[:end]) is not None for end in range(0, len(data) - 13, 37))
