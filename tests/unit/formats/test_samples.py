"""Real files of every vendor, where somebody has them: the values that stand in them, and rosettasciio where it is right."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from rsciio.tiff import file_reader

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.scan import Provenance
from semlive.data.settings import ScanProfile, ScanSpeed
from semlive.errors import BadImage
from semlive.formats import read_frame, read_info
from semlive.formats.images.frames import parse_file, read_pixels, read_sidecar
from semlive.formats.images.inspection import inspect_file, inspect_sidecar

MTIME_NS = 1_700_000_000_000_000_000
FILE, DERIVED, CONFIG, ASSUMED = Provenance.FILE, Provenance.DERIVED, Provenance.CONFIG, Provenance.ASSUMED


@pytest.fixture
def samples() -> Path:
    folder = os.environ.get("SEMLIVE_SAMPLES")
    if not folder:
        pytest.skip("SEMLIVE_SAMPLES does not name the folder of real export files")
    return Path(folder)


def exported(samples: Path, name: str) -> ExportedFile:
    path = samples / name
    text_path = path.with_suffix(".txt")
    return ExportedFile(0, name, path.read_bytes(), "", MTIME_NS, MTIME_NS, text_path.read_bytes() if text_path.exists() else None)


def ns(*date_and_time: int) -> int:
    return int(datetime(*date_and_time, tzinfo=UTC).timestamp()) * 10**9  # type: ignore[arg-type]


def times(info: FrameInfo) -> tuple[float, float, float, int, int]:
    timing = info.timing
    counts = timing.integrations.value, timing.line_integrations.value
    return timing.dwell_time_s.value, timing.row_time_s.value, timing.frame_time_s.value, *counts


def sources(info: FrameInfo) -> tuple[Provenance, ...]:
    timing = info.timing
    return timing.dwell_time_s.source, timing.row_time_s.source, timing.frame_time_s.source, info.pixel_size_m.source


def column(info: FrameInfo) -> tuple[object, ...]:
    printed = info.column
    return tuple(
        None if item is None else item.value
        for item in (printed.detector, printed.voltage_v, printed.working_distance_m, printed.magnification, printed.scan_rotation_deg)
    )


def scale_by_rosettasciio(path: Path) -> tuple[float, str]:
    axis = file_reader(str(path))[0]["axes"][1]
    return axis["scale"], axis["units"]


def test_thermo_fisher(samples: Path) -> None:
    frame = read_frame(exported(samples, "tfs_example.tif"), ScanProfile())
    info = frame.info
    assert (info.vendor, frame.image.shape, info.databar_rows) == ("fei", (1024, 1536), 68)  # although its DatabarHeight is 0
    assert times(info) == (1e-6, 0.001714, 1.75685, 1, 1)
    assert info.pixel_size_m.value == 2.69792e-07
    assert sources(info) == (FILE,) * 4
    assert column(info) == ("ETD", 2000.0, 0.00681643, None, 0.0)
    assert info.end_time_ns == ns(2023, 11, 10, 14, 9, 15) + 500_000_000
    assert info.start_sigma_s == 0.3
    assert scale_by_rosettasciio(samples / "tfs_example.tif") == (pytest.approx(2.69792e-07), "m")


@pytest.mark.parametrize("bits", [8, 16])
def test_helios(samples: Path, bits: int) -> None:
    name = f"FEI-Helios-Ebeam-{bits}bits.tif"
    file = exported(samples, name)
    info = read_info(file, ScanProfile())
    assert (info.width_px, info.height_px, info.databar_rows) == (512, 442, 29)
    assert times(info) == (1e-5, 0.0058, 2.62, 1, 1)
    assert column(info)[:3] == ("ETD", 5000.0, 0.00403466)
    assert read_pixels(parse_file(file)).dtype == (np.uint8 if bits == 8 else np.uint16)
    assert scale_by_rosettasciio(samples / name) == (pytest.approx(info.pixel_size_m.value), "m")
    with pytest.raises(BadImage, match="every pixel is 0"):  # the beam was blanked
        read_frame(file, ScanProfile())


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("tfs_example.tif", {"tilt_correction": False, "dynamic_focus": False, "zoom": 1.0, "area": "full frame", "mode": "Field-Free"}),
        ("zeiss_example_sem.tif", {"tilt_correction": False, "dynamic_focus": False, "zoom": 1.0, "mode": "orthogonality correction"}),
        ("test_tiff_Zeiss_SEM_512pix.tif", {"zoom": 1.0, "drift_correction": False}),
        ("tescan_example_sem1.tif", {"tilt_correction": False, "pixel_height_m": 2.5012e-6, "mode": "WIDE FIELD"}),
        ("jeol_example_sem.tif", {"mode": "column SEM, scan 2, integration 0"}),
    ],
)
def test_settings_that_change_geometry(samples: Path, name: str, settings: dict[str, object]) -> None:
    header = parse_file(exported(samples, name)).header
    assert header.geometry.values().items() >= settings.items()
    height, width = header.geometry.pixel_height_m, header.pixel_size_m
    if height is not None and width is not None:
        assert height.value == pytest.approx(width.value)


def test_navigation_camera_is_refused(samples: Path) -> None:
    file = exported(samples, "FEI-Helios-navcam-with-no-IRBeam-bad-floats.tif")
    parsed = parse_file(file)
    header, width, rows = parsed.header, parsed.width_px, parsed.rows
    assert (width, rows, header.vendor) == (768, 551, "fei")
    assert (header.dwell_time_s, header.row_time_s, header.pixel_size_m, header.column.voltage_v) == (None,) * 4
    with pytest.raises(BadImage, match="Beam=IRBeam"):
        read_info(file, ScanProfile(dwell_time_s=1e-5, row_time_s=1.0, pixel_size_m=1e-8))


def test_zeiss(samples: Path) -> None:
    frame = read_frame(exported(samples, "zeiss_example_sem.tif"), ScanProfile())
    info = frame.info
    assert (info.vendor, frame.image.shape, info.databar_rows) == ("zeiss", (768, 1024), 0)
    dwell_s, row_s, frame_s, frames, passes = times(info)
    assert (row_s, frame_s, frames, passes) == (949e-6, 0.75276, 1, 1)  # "Pixel Avg." although Line Avg.Count = 2
    assert dwell_s == 949e-6 / 1024  # 0.93 us, where DP_DWELL_TIME is 50 ns
    assert frame_s / row_s - 768 == pytest.approx(25.2, abs=0.05)
    assert info.pixel_size_m.value == 5.932882e-07
    assert sources(info) == (DERIVED, FILE, FILE, FILE)
    assert column(info) == ("InLens", 5000.0, pytest.approx(0.0052), 188.0, 0.0)
    assert info.end_time_ns == ns(2023, 4, 11, 8, 40, 47) + 500_000_000
    assert scale_by_rosettasciio(samples / "zeiss_example_sem.tif") == (pytest.approx(5.932882e-07), "m")


def test_old_zeiss_file_has_no_timing(samples: Path) -> None:
    file = exported(samples, "test_tiff_Zeiss_SEM_512pix.tif")
    with pytest.raises(
        BadImage, match=r"dwell time and row time; set sem\.profile\.dwell_time_s, sem\.profile\.row_time_s, or a row of sem\.scan"
    ):
        read_info(file, ScanProfile())
    speeds = (ScanSpeed("6", "ULTRA", 512, dwell_time_s=1e-6, row_time_s=6e-3),)
    info = read_info(file, ScanProfile(speeds=speeds))
    assert times(info) == (1e-6, 6e-3, 384 * 6e-3, 1, 10)
    assert info.pixel_size_m.value == pytest.approx(5.824988e-9 * 2)  # the file's number is for 1024 px
    assert sources(info) == (CONFIG, CONFIG, DERIVED, DERIVED)
    assert column(info)[:4] == ("InLens", 5000.0, 0.0039, 50_000.0)
    assert info.end_time_ns == ns(2018, 9, 25, 8, 20, 42) + 500_000_000
    scale, unit = scale_by_rosettasciio(samples / "test_tiff_Zeiss_SEM_512pix.tif")
    assert scale * {"nm": 1e-9, "m": 1.0}[unit] == pytest.approx(info.pixel_size_m.value, rel=1e-3)


def test_tescan(samples: Path) -> None:
    file = exported(samples, "tescan_example_sem1.tif")
    with pytest.raises(BadImage, match=r"row time; set sem\.profile\.row_time_s, or a row of sem\.scan_profiles for its scan speed 4"):
        read_info(file, ScanProfile())
    frame = read_frame(file, ScanProfile(speeds=(ScanSpeed("4", "MIRA3", row_time_s=3.6e-3),)))
    info = frame.info
    assert (info.vendor, frame.image.shape, frame.image.dtype, info.databar_rows) == ("tescan", (768, 1024), np.uint16, 120)
    assert times(info) == (3.2e-6, 3.6e-3, 768 * 3.6e-3, 1, 1)
    assert info.pixel_size_m.value == 2.5012e-6
    assert sources(info) == (FILE, CONFIG, DERIVED, FILE)
    assert column(info) == ("SE", 10_000.0, 0.01325, 108.08, 0.0)
    assert info.end_time_ns == ns(2016, 5, 16, 16, 3, 27) + 500_000_000  # not TIFF's DateTime, 11 s later


def test_jeol(samples: Path) -> None:
    file = exported(samples, "jeol_example_sem.tif")
    timing = ScanProfile(speeds=(ScanSpeed("7", "4700F", dwell_time_s=5e-6, row_time_s=7e-3),))
    with pytest.raises(
        BadImage, match=r"pixel size; set sem\.profile\.pixel_size_m, or sem\.profile\.field_width_mm_at_1x for its magnification 50 in"
    ):  # exported without bar
        read_info(file, timing)
    frame = read_frame(file, replace(timing, field_width_mm_at_1x=128.0))
    info = frame.info
    assert (info.vendor, frame.image.shape, info.databar_rows) == ("jeol", (960, 1280), 0)
    assert times(info) == (5e-6, 7e-3, 6.72, 1, 1)
    assert info.pixel_size_m.value == pytest.approx(2e-6)
    assert sources(info) == (CONFIG, CONFIG, DERIVED, CONFIG)
    assert column(info) == ("LED", 5000.0, pytest.approx(0.00907), 50.0, 0.0)
    assert info.end_time_ns == ns(2025, 11, 20, 13, 42, 14) + 500_000_000
    with pytest.raises(BadImage, match="dwell time, row time and pixel size"):  # without its sidecar it has no timing
        read_info(replace(file, sidecar=None), ScanProfile())


def test_hitachi_sidecar(samples: Path) -> None:
    sidecar = (samples / "tm3000_sidecar_blocen.txt").read_bytes()
    for text in (sidecar, b"[SemImageFile]\r\n" + sidecar, sidecar.decode("cp1252").encode("utf-16")):
        header = read_sidecar(text, MTIME_NS)
        assert header is not None
        assert (header.vendor, header.instrument, header.scan_speed) == ("hitachi", "TM3000", "Slow3")
        assert (header.width_px, header.rows) == (1280, 1100)
        assert header.pixel_size_m is not None
        assert header.pixel_size_m.value == pytest.approx(506.25e-9)
        assert (header.dwell_time_s, header.row_time_s, header.frame_time_s) == (None,) * 3
        assert header.embedded is not None
        assert header.embedded.time_ns == ns(2016, 8, 16, 18, 56, 58) + 500_000_000
        printed = header.column
        assert [
            item.value for item in (printed.detector, printed.voltage_v, printed.working_distance_m, printed.magnification) if item
        ] == [
            "BSE COMPO",
            15_000.0,
            pytest.approx(6.9e-3),
            250.0,
        ]


def test_inspect_finds_every_sample_complete(samples: Path) -> None:
    images = sorted(samples.glob("*.tif"))
    assert len(images) == 8
    observed = {path.name: inspect_file(exported(samples, path.name), ScanProfile()) for path in images}
    assert all(item.complete for item in observed.values())
    assert observed["tfs_example.tif"].problems == observed["zeiss_example_sem.tif"].problems == ()
    assert "Beam=IRBeam" in observed["FEI-Helios-navcam-with-no-IRBeam-bad-floats.tif"].problems[0]
    alone = inspect_sidecar("tm3000.txt", (samples / "tm3000_sidecar_blocen.txt").read_bytes(), MTIME_NS, ScanProfile())
    assert alone is not None
    assert (alone.width_px, alone.height_px, alone.acquired.value, alone.complete) == (1280, 1100, "2016-08-16T18:56:58", False)
