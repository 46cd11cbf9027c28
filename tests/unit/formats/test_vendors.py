"""Headers as text, with the values that real files of each vendor printed, and the traps they are known for."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from io import BytesIO

import numpy as np
import pytest
import tifffile

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.scan import Provenance
from semlive.data.settings import ScanProfile, ScanSpeed
from semlive.errors import BadImage
from semlive.formats import read_frame, read_info
from semlive.formats.images.frame_metadata import frame_info
from semlive.formats.metadata.header import Header
from semlive.formats.metadata.quantity import quantity
from semlive.formats.metadata.timestamps import dated, iso
from semlive.formats.vendors import fei, hitachi, jeol, tescan, zeiss
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

MTIME_NS = int(datetime(2016, 8, 16, 19, tzinfo=UTC).timestamp()) * 10**9
EMPTY = ExportedFile(0, "a.tif", b"", "", MTIME_NS, MTIME_NS)


def info_of(header: Header, width: int, rows: int, profile: ScanProfile | None = None) -> FrameInfo:
    return frame_info(EMPTY, header, width, rows, profile or ScanProfile())


def fei_header(size: tuple[int, int], dwell: str, line: str, frame: str, passes: int = 1, integrate: int = 1, average: int = 0) -> Header:
    ini = (
        f"[User]\nDate=11/10/2023\nTime=02:09:15 PM\n[Beam]\nBeam=EBeam\n[Scan]\nIntegrate=1\n[EScan]\nDwell={dwell}\nLineTime={line}\n"
        f"FrameTime={frame}\nLineIntegration={passes}\nPixelWidth=1e-7\n[Image]\nIntegrate={integrate}\nAverage={average}\n"
        f"ResolutionX={size[0]}\nResolutionY={size[1]}\n"
    )
    return fei.header(fei.FeiText(fei.parse_ini(ini), {}))


@pytest.mark.parametrize(
    ("name", "size", "bar", "dwell_us", "passes", "line_ms", "frame_s", "flyback_us", "overhead"),
    [
        ("1-2500_014.tif", (1536, 1024), 79, 10.0, 2, 31.76, 32.6175, 520, 3.00),
        ("1-2k_031.tif", (1536, 1024), 79, 10.0, 2, 31.72, 32.5764, 500, 3.00),
        ("2_cal_2.tif", (1536, 1024), 79, 10.0, 2, 31.36, 32.2067, 320, 3.00),
        ("Mus.-800_019", (1536, 1024), 79, 10.0, 2, 31.16, 32.0013, 220, 3.00),
        ("ebsdcorr_BSE", (1536, 1024), 0, 6.0, 1, 9.636, 9.89617, 420, 3.00),
        ("tfs_example", (1536, 1024), 68, 1.0, 1, 1.714, 1.75685, 178, 1.00),
        ("FEI-Helios", (512, 442), 29, 10.0, 1, 5.8, 2.62, 680, 9.72),
        ("quad1image", (1024, 884), 0, 30.0, 1, 33.3333, 29.5667, 2613, 3.00),
    ],
)
def test_fei_timing_of_real_files(
    name: str,
    size: tuple[int, int],
    bar: int,
    dwell_us: float,
    passes: int,
    line_ms: float,
    frame_s: float,
    flyback_us: float,
    overhead: float,
) -> None:
    info = info_of(fei_header(size, f"{dwell_us}e-006", f"{line_ms}e-003", str(frame_s), passes), size[0], size[1] + bar)
    timing = info.timing
    assert (info.width_px, info.height_px, info.databar_rows) == (*size, bar)
    assert timing.row_time_s.value == pytest.approx(line_ms * 1e-3, rel=1e-12), name  # never width x dwell
    flyback_s = timing.row_time_s.value / passes - size[0] * timing.dwell_time_s.value
    assert flyback_s * 1e6 == pytest.approx(flyback_us, abs=0.6)
    assert timing.frame_time_s.value / timing.row_time_s.value - size[1] == pytest.approx(overhead, abs=0.01)


def test_five_integrated_frames_of_a_quanta_count_although_its_scan_section_reports_one() -> None:
    header = fei_header((1024, 884), "3e-005", "0.0333333", "29.5667", integrate=5)
    info = info_of(header, 1024, 884)
    assert info.timing.integrations.value == 5
    assert info.timing.duration_s == pytest.approx(5 * 29.5667)
    assert "[Image] is used" in info.notes[0]


def test_a_running_average_is_refused_but_its_timing_is_read() -> None:
    header = fei_header((512, 442), "5e-008", "2.625e-005", "0.01202", average=4)
    assert header.row_time_s is not None
    assert header.row_time_s.value == 26.25e-6
    assert header.refused is not None
    with pytest.raises(BadImage, match="running average"):
        info_of(header, 512, 471)


def test_newer_fei_files_with_xml_alone() -> None:
    xml = (
        "<Metadata><Acquisition><AcquisitionDatetime>2023-11-10T14:09:15.25+01:00</AcquisitionDatetime></Acquisition>"
        "<Optics><AccelerationVoltage>5000</AccelerationVoltage><WorkingDistance>0.004</WorkingDistance></Optics>"
        "<BinaryResult><FilterType>{filter}</FilterType><FilterFrameCount>4</FilterFrameCount><PixelSize><X>2e-8</X></PixelSize></BinaryResult>"
        "<ScanSettings><DwellTime>1e-6</DwellTime><LineTime>0.0031665</LineTime><LineIntegrationCount>1</LineIntegrationCount>"
        "<FrameTime>12.969984</FrameTime><ScanRotation>0</ScanRotation></ScanSettings></Metadata>"
    )
    info = info_of(fei.header(fei.FeiText({}, fei.parse_xml(xml.format(filter="FrameIntegration")))), 3072, 2048)
    assert (info.timing.row_time_s.value, info.timing.integrations.value) == (0.0031665, 4)
    assert info.end_time_ns == int(datetime(2023, 11, 10, 13, 9, 15, 250_000, tzinfo=UTC).timestamp() * 1e3) * 10**6
    with pytest.raises(BadImage, match="already corrected drift"):
        info_of(fei.header(fei.FeiText({}, fei.parse_xml(xml.format(filter="DriftCorrectedFrameIntegration")))), 3072, 2048)


def zeiss_text(
    line: str, cycle: str, mode: str = "Pixel Avg.", passes: int = 1, counter: int = 0, more: dict[str, str] | None = None
) -> str:
    lines = {
        "DP_DWELL_TIME": "Dwell Time = 100 ns", "DP_SCANRATE": "Scan Speed = 6", "DP_NOISE_REDUCTION": f"Noise Reduction = {mode}",
        "AP_LINE_AVERAGE_COUNT": f"Line Avg.Count = {passes}   ", "AP_LINE_COUNTER": f"Line Counter = {counter}   ",
        "AP_LINE_TIME": f"Line Time = {line}", "AP_FRAME_TIME": f"Cycle Time = {cycle}", "AP_DATE": "Date :18 Jul 2019",
        "AP_TIME": "Time :9:40:32", "AP_MAG": "Mag =  10.00 K X", **(more or {}),
    }  # fmt: skip
    numbers = ["0", "0", "0", "2.465e-08", "1.0e+4", "6", "5.0e+03"]
    return "\r\n".join([*numbers, *(part for pair in lines.items() for part in pair)])


@pytest.mark.parametrize(
    ("line", "cycle", "mode", "passes", "dwell_us"),
    [
        ("949  µs", "752.76 ms", "Pixel Avg.", 1, 0.93),
        ("3.379 ms", "2.6 Secs", "Pixel Avg.", 1, 3.30),
        ("33.79 ms", "26.0 Secs", "Line Int. Done", 10, 3.30),
        ("13.21 ms", "10.2 Secs", "Pixel Avg.", 1, 12.9),
        ("52.22 ms", "40.2 Secs", "Pixel Avg.", 1, 51.0),
    ],
)
def test_zeiss_dwell_comes_from_the_line_time_and_its_passes(line: str, cycle: str, mode: str, passes: int, dwell_us: float) -> None:
    info = info_of(zeiss.header(zeiss.parse(zeiss_text(line, cycle, mode, passes)), 1024, 768), 1024, 768)
    assert info.timing.dwell_time_s.value * 1e6 == pytest.approx(dwell_us, rel=0.005)
    assert info.timing.dwell_time_s.source is Provenance.DERIVED
    assert info.timing.line_integrations.value == passes
    assert info.timing.row_time_s.value == pytest.approx(passes * 1024 * info.timing.dwell_time_s.value)


@pytest.mark.parametrize(
    ("cycle", "frame_s", "source"),
    [
        ("154.12 Secs", 154.12, Provenance.FILE),
        ("1.9 Mins", 768 * 0.15, Provenance.DERIVED),  # two digits: it would end before its last rows
        ("2.0 Mins", 768 * 0.15, Provenance.DERIVED),  # and this one is not finer
        ("", 768 * 0.15, Provenance.DERIVED),
    ],
)
def test_a_cycle_time_in_minutes_is_too_coarse(cycle: str, frame_s: float, source: Provenance) -> None:
    info = info_of(zeiss.header(zeiss.parse(zeiss_text("150 ms", cycle)), 1024, 768), 1024, 768)
    assert info.timing.frame_time_s.value == pytest.approx(frame_s)
    assert info.timing.frame_time_s.source is source


@pytest.mark.parametrize(("counter", "rows"), [(709, 709), (712, 712), (762, 712)])
def test_a_zeiss_file_saved_in_the_middle_of_a_scan_counts_to_the_row_it_had_reached(counter: int, rows: int) -> None:
    busy = {"DP_FROZEN": "Image = Live"}
    header = zeiss.header(zeiss.parse(zeiss_text("33.79 ms", "26.0 Secs", "Line Int. Busy", 10, counter, busy)), 1024, 768)
    info = info_of(header, 1024, 768, ScanProfile(databar_rows=56))  # the data zone begins at row 712
    assert info.height_px == rows
    assert f"{counter} of 768 rows" in info.notes[0]
    saved_ns = int(datetime(2019, 7, 18, 9, 40, 32, tzinfo=UTC).timestamp()) * 10**9 + 500_000_000
    assert info.start_time_ns.value == saved_ns - round(counter * 33.79e-3 * 1e9)


def test_zeiss_pixel_size_is_for_1024_px_and_the_micro_sign_may_be_spoilt() -> None:
    reported = {"AP_PIXEL_SIZE": "Pixel Size = 24.65 nm", "AP_IMAGE_PIXEL_SIZE": "Image Pixel Size = 12.33 nm"}
    text = zeiss_text("3 ms", "5 Secs", more=reported)
    info = info_of(zeiss.header(zeiss.parse(text), 2048, 1536), 2048, 1536)
    assert info.pixel_size_m.value == pytest.approx(12.325e-9)
    assert info.column.magnification is not None
    assert info.column.magnification.value == 10_000
    for spelling in ("949 µs", "949 us", "949  ?s", "949 \u03bcs", "949 Âµs", "949 \ufffds"):
        found = quantity(spelling)
        assert found is not None
        assert found.value == pytest.approx(949e-6)
    wrong = zeiss.header(zeiss.parse(text.replace("12.33", "99.99")), 2048, 1536)
    assert wrong.pixel_size_m is not None
    assert wrong.pixel_size_m.value == pytest.approx(99.99e-9)
    assert "AP_IMAGE_PIXEL_SIZE" in wrong.notes[0]


def test_a_zeiss_frame_average_is_refused() -> None:
    more = {"AP_FRAME_AVERAGE_COUNT": "Frames to average = 8"}
    with pytest.raises(BadImage, match="running average"):
        info_of(zeiss.header(zeiss.parse(zeiss_text("3 ms", "5 Secs", "Frame Avg", more=more)), 1024, 768), 1024, 768)


def test_tescan_amber_tag_and_hdr_carry_the_same() -> None:
    keys = (
        "Date=2025-12-03\r\nDevice=TESCAN AMBER X\r\nImageStripSize=0\r\nPixelSizeX=1.5625e-9\r\nPixelSizeY=1.5625e-9\r\nTime=17:19:26\r\n"
    )
    sem = "DwellTime=10.000e-6\r\nScanSpeed=6\r\n"
    hdr = tescan.read_sidecar(f"[MAIN]\r\n{keys}[SEM]\r\n{sem}".encode("cp1252"))
    damaged = tescan.parse_tag(b"\xff\xff\xff\x7fA" + f"AccFrames=1\r\n{keys}{sem}".encode("cp1252"))
    for header in (hdr, tescan.header(damaged)):
        assert header is not None
        info = info_of(header, 1024, 768, ScanProfile(row_time_s=0.012))
        assert (info.timing.dwell_time_s.value, info.pixel_size_m.value) == (1e-5, 1.5625e-9)
        assert info.end_time_ns == int(datetime(2025, 12, 3, 17, 19, 26, tzinfo=UTC).timestamp()) * 10**9 + 500_000_000


def test_jeol_pixel_size_is_that_of_the_bar_not_of_the_magnification() -> None:
    lines = (
        "$CM_MAG 50",
        "$CM_FULL_SIZE 1280 960",
        "$$SM_MICRON_BAR 53",
        "$$SM_MICRON_MARKER 100um",
        "$CM_DATE 2019-02-03",
        "$CM_TIME 01:02:03",
    )
    text = "\r\n".join(lines).encode()
    header = jeol.read_sidecar(text)
    assert header is not None
    profile = ScanProfile(dwell_time_s=1e-6, row_time_s=2e-3, field_width_mm_at_1x=128.0)
    info = info_of(header, 1280, 1024, profile)
    assert (info.height_px, info.databar_rows) == (960, 64)
    assert info.pixel_size_m.value == pytest.approx(1.887e-6, abs=1e-9)  # 128 mm / 50 / 1280 px would be 2.0 um
    assert "0.9 %" in info.notes[0]
    assert info.end_time_ns == int(datetime(2019, 2, 3, 1, 2, 3, tzinfo=UTC).timestamp()) * 10**9 + 500_000_000
    with pytest.raises(BadImage, match="1024 px wide but its header contains 1280"):  # the sidecar of another image
        info_of(header, 1024, 768, profile)


@pytest.mark.parametrize(
    ("date", "month", "day"), [("08/05/2016", 5, 8), ("05/08/2016", 8, 5), ("16/08/2016", 8, 16), ("08/16/2016", 8, 16)]
)
def test_hitachi_day_and_month_are_separated_by_the_modification_time(date: str, month: int, day: int) -> None:
    values = {"InstructName": "TM3000", "DataSize": "1280x1100", "PixelSize": "506.25", "Date": date, "Time": "18:56:58"}
    mtime_ns = int(datetime(2016, month, day, 19, tzinfo=UTC).timestamp()) * 10**9
    header = hitachi.header(values, mtime_ns)
    assert header.embedded is not None
    assert header.embedded.time_ns == mtime_ns - 182 * 10**9 + 500_000_000
    assert bool(header.notes) == (day <= 12)


def test_scan_profiles_fill_by_instrument_speed_and_width() -> None:
    header = Header(vendor="jeol", instrument="JSM-7001F", scan_speed="9", pixel_size_m=None)
    speeds = (
        ScanSpeed("9", "JSM-6", dwell_time_s=1e-6, row_time_s=1.0),
        ScanSpeed("9", "JSM-7", 640, dwell_time_s=2e-6, row_time_s=1.0),
        ScanSpeed("9", "JSM-7", dwell_time_s=3e-6, row_time_s=5e-3, frame_time_s=6.0),
    )
    profile = ScanProfile(speeds=speeds, dwell_time_s=4e-6, pixel_size_m=1e-7)
    timing = info_of(header, 1280, 960, profile).timing
    assert (timing.dwell_time_s.value, timing.row_time_s.value, timing.frame_time_s.value) == (3e-6, 5e-3, 6.0)
    assert timing.row_time_s.source is Provenance.CONFIG
    assert info_of(header, 640, 480, profile).timing.dwell_time_s.value == 2e-6
    with pytest.raises(BadImage, match=r"row time; set sem\.profile\.row_time_s, or a row of sem\.scan_profiles for its scan speed 8"):
        info_of(replace(header, scan_speed="8"), 1280, 960, profile)
    with pytest.raises(BadImage, match=r"correct sem\.profile or sem\.scan_profiles"):
        info_of(header, 1280, 960, replace(profile, speeds=(ScanSpeed("9", dwell_time_s=1e-5, row_time_s=1e-3),)))


def test_the_microscopes_clock_is_set_right_and_a_saved_time_is_taken_back() -> None:
    header = fei_header((512, 442), "1e-005", "0.0058", "2.62")
    plain = info_of(header, 512, 442)
    offset = info_of(header, 512, 442, ScanProfile(clock_offset_s=3600.0))
    assert plain.start_time_ns.value - offset.start_time_ns.value == 3600 * 10**9
    assert plain.embedded_time_ns == offset.embedded_time_ns == plain.end_time_ns
    saved = info_of(header, 512, 442, ScanProfile(start_anchor="save", save_delay_s=11.0, start_sigma_s=2.0))
    assert plain.start_time_ns.value - saved.start_time_ns.value == 11 * 10**9
    assert (saved.start_sigma_s, saved.start_anchor) == (2.0, "save")


def test_line_integration_is_later_by_half_its_other_passes() -> None:
    timing = info_of(fei_header((1536, 1024), "1e-005", "0.03176", "32.6175", passes=2), 1536, 1024).timing
    assert float(timing.time_in_frame_s(0, 0)) == pytest.approx(0.25 * 0.03176)


def test_dates_that_are_none_are_none() -> None:
    assert dated("31/02/2020", "dmy", "10:00:00") is None
    assert dated("18 Jul 2019", "dmy", "9:40") is None
    assert dated("18 Xyz 2019", "dmy", "9:40:32") is None
    assert iso("2023-11-10T25:00:00") is None
    assert iso("0001-01-01T00:00:00") is None
    twelve = [dated("1/2/2020", "dmy", clock) for clock in ("12:00:00 AM", "00:00:00")]
    assert twelve[0] == twelve[1]


SCAN = replace(load_scenario("paper_x200").scan, width_px=256, height_px=200, frame_time_s=200 * 0.0268)
END_NS = 1_772_439_825_123_456_789


@pytest.mark.parametrize("vendor", [vendor for vendor in Vendor if vendor not in (Vendor.TIFF, Vendor.PNG)])
def test_files_of_the_virtual_microscope_come_back_with_its_truth(vendor: Vendor) -> None:
    image = np.random.default_rng(1).integers(0, 256, (200, 256), dtype=np.uint8)
    facts = ImageMetadata(SCAN, END_NS, 1.0, 2.0, frame=4, name="a.tif")
    made = Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 20, "a", vendor).encode(image, facts)
    speed = {Vendor.TESCAN: "7", Vendor.JEOL: "9", Vendor.HITACHI: "Slow3"}.get(vendor, "")
    profile = ScanProfile(databar_rows=20, speeds=(ScanSpeed(speed, dwell_time_s=SCAN.dwell_time_s, row_time_s=SCAN.row_time_s),))
    file = ExportedFile(0, "a.tif", made.image, "", END_NS, END_NS, made.sidecar)
    frame = read_frame(file, profile)
    info = frame.info
    assert info.vendor == vendor.value
    stored = 180 if vendor is Vendor.ZEISS else 200  # there the bar covers the image
    shown = (frame.image >> 8).astype(np.uint8) if vendor is Vendor.TESCAN else frame.image
    assert np.array_equal(shown, image[:stored])
    assert info.timing.row_time_s.value == pytest.approx(SCAN.row_time_s, rel=1e-4)
    assert info.timing.dwell_time_s.value == pytest.approx(SCAN.dwell_time_s, rel=0.05)
    assert info.pixel_size_m.value == pytest.approx(SCAN.pixel_size_um * 1e-6, rel=0.01)
    assert abs(info.end_time_ns - END_NS) < 6e8
    assert read_info(replace(file, data=made.image), profile) == info


def test_of_a_zeiss_file_with_two_pages_the_first_counts() -> None:
    image = np.random.default_rng(2).integers(0, 256, (48, 64), dtype=np.uint8)
    stream = BytesIO()
    text = zeiss_text("3 ms", "200 ms").encode("cp1252")
    with tifffile.TiffWriter(stream) as writer:
        writer.write(image, metadata=None, extratags=[(34118, 2, len(text), text, True)])
        writer.write(image[::2, ::2], metadata=None)
    frame = read_frame(ExportedFile(0, "a.tif", stream.getvalue(), "", MTIME_NS, MTIME_NS), ScanProfile())
    assert frame.info.vendor == "zeiss"
    assert np.array_equal(frame.image, image)
