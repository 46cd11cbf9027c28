"""An instrument's own clock: measured row starts and clock channels replace equations 1 to 4."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from semlive.data.frame import ExportedFile
from semlive.data.scan import Provenance, RowClock, ScanTiming, Sourced
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage, BadInput
from semlive.formats import read_info
from semlive.formats.log.conversions import frame_info, scan_message
from semlive.formats.log.messages import ScanMessage
from semlive.formats.metadata.row_clock import is_row_clock, read_row_clock
from semlive_simulators.effects.scan_timing import IrregularRows
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Vendor
from semlive_simulators.scenario import load_scenario

PROFILE = ScanProfile(dwell_time_s=1e-4, row_time_s=0.01, frame_time_s=0.4, pixel_size_m=1e-6)


def timing(clock: RowClock | None = None) -> ScanTiming:
    values = (Sourced(value, Provenance.FILE) for value in (1e-4, 0.01, 0.4))
    return ScanTiming(*values, Sourced(1, Provenance.FILE), clock=clock)


def test_even_rows_are_equation_3() -> None:
    even = RowClock(tuple((0.01 * np.arange(40)).tolist()))
    x, y = np.array([0.0, 10.5, 60.0]), np.array([-0.5, 12.25, 41.0])
    assert timing(even).time_in_frame_s(x, y) == pytest.approx(timing().time_in_frame_s(x, y), abs=1e-12)


def test_the_time_in_a_row_is_that_of_its_own_pixels() -> None:
    x, y = np.array([0.0, 10.0, 63.0]), np.array([2.0, 3.0, 30.0])
    own = RowClock(tuple((0.01 * np.arange(40)).tolist()), (2e-4,) * 40)
    np.testing.assert_array_equal(timing().time_in_row_s(x, y), 1e-4 * x)
    np.testing.assert_allclose(timing(own).time_in_row_s(x, y), 2e-4 * x, atol=1e-12)


def test_a_pause_delays_all_later_rows() -> None:
    starts = 0.01 * np.arange(40) + np.where(np.arange(40) >= 20, 3.0, 0.0)
    clocked = timing(RowClock(tuple(starts.tolist())))
    assert clocked.time_in_frame_s(5.0, 19.0) == pytest.approx(0.19 + 5e-4)
    assert clocked.time_in_frame_s(5.0, 20.0) == pytest.approx(3.2 + 5e-4)


def test_rows_from_right_to_left_have_a_negative_time_per_pixel() -> None:
    row, column = np.mgrid[:6, :50]
    time_s = 0.01 * row + 1e-4 * np.where(row % 2, 49 - column, column)
    clock = RowClock.of_channel(time_s)
    at = timing(clock).time_in_frame_s(column.ravel(), row.ravel()).reshape(6, 50)
    np.testing.assert_allclose(at, time_s, atol=1e-12)


@pytest.mark.parametrize("head", ["row_start_s", "Row_Start_s", "# row_start_s", "row_start_s;pixel_time_s"])
def test_a_table_holds_the_start_of_each_row(head: str) -> None:
    more = ";0.0002" if ";" in head else ""
    data = (head + "\n" + "".join(f"{0.02 * row!r}{more}\n" for row in range(5))).encode()
    assert is_row_clock(data)
    clock = read_row_clock(data, "clock.csv", 64, 5)
    assert clock.row_start_s == tuple(0.02 * row for row in range(5))
    assert clock.pixel_time_s == ((2e-4,) * 5 if more else ())


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"row_start_s\n0\n0.1\n", "holds 2 rows, and the frame has 5"),
        (b"row_start_s\n0\n0.1\nx\n0.3\n0.4\n", "line 4, column row_start_s"),
        (b"row_start_s\n-1\n0.1\n0.2\n0.3\n0.4\n", "before the scan"),
        (b"start\n0\n1\n2\n3\n4\n", "column row_start_s is missing"),
    ],
)
def test_a_wrong_table_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        read_row_clock(data, "clock.csv", 64, 5)


def test_a_channel_that_no_row_clock_describes_is_refused() -> None:
    row, column = np.mgrid[:5, :64]
    stream = io.BytesIO()
    np.save(stream, 0.1 * row + 1e-3 * column + 0.02 * (column > 40))
    with pytest.raises(BadInput, match="deviate"):
        read_row_clock(stream.getvalue(), "clock.npy", 64, 5)


def packed(name: str, content: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return stream.getvalue()


def head_of(shape: tuple[int, int]) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (head_of((10**6, 10**6)), "has the shape"),
        (packed("time_s.npy", head_of((10**6, 64)) + bytes(10**7)), "has the shape"),
        (head_of((5, 64)), "ends after 0 of 2560 bytes"),
        (packed("a.npy", head_of((5, 64))), "holds a.npy"),
        (packed("time_s.npy", bytes(100)), "is no NumPy array"),
        (packed("time_s.npy", head_of((5, 64)))[:-30], "is no NumPy array"),
        (b"PK\x03\x04" + bytes(60), "is no NumPy array"),
    ],
)
def test_a_wrong_channel_is_refused_before_it_is_unpacked(data: bytes, message: str) -> None:
    tracemalloc.start()
    with pytest.raises(BadInput, match=message):
        read_row_clock(data, "clock.npz", 64, 5)
    _, largest_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert largest_bytes < 2_000_000


def exported(sidecar: bytes | None) -> ExportedFile:
    stream = io.BytesIO()
    tifffile.imwrite(stream, np.arange(40 * 64, dtype=np.uint8).reshape(40, 64))
    return ExportedFile(0, "frame.tif", stream.getvalue(), "", 10**18, 10**18, sidecar)


def test_the_text_file_of_an_image_is_its_clock_and_survives_the_log() -> None:
    starts = [0.01 * row + 0.5 * (row > 7) for row in range(40)]
    sidecar = ("row_start_s\n" + "".join(f"{value!r}\n" for value in starts)).encode()
    info = read_info(exported(sidecar), PROFILE)
    assert info.timing.clock == RowClock(tuple(starts))
    assert not any("text file" in note for note in info.notes)
    assert read_info(exported(None), PROFILE).timing.clock is None
    logged = ScanMessage.model_validate_json(scan_message(info).model_dump_json())
    assert frame_info(logged).timing == info.timing


def test_a_clock_of_another_frame_is_refused() -> None:
    with pytest.raises(BadImage, match="holds 2 rows"):
        read_info(exported(b"row_start_s\n0\n1\n"), PROFILE)


def test_the_simulator_writes_the_clock_that_its_scan_followed() -> None:
    scenario = load_scenario("short")
    effects = replace(scenario.effects, members=(IrregularRows(0.01, 20, 5.0),))
    export = replace(scenario.export, vendor=Vendor.TIFF, row_clock=True)
    scenario = replace(scenario, effects=effects, export=export)
    scan = scenario.scan
    facts = ImageMetadata(scan, 10**18, 0.0, 0.0, 0, row_start_s=scenario.row_start_s)
    product = export.encode(np.zeros((scan.height_px, scan.width_px), np.uint8), facts)
    assert product.sidecar is not None
    clock = read_row_clock(product.sidecar, "clock", scan.width_px, scan.height_px)
    true_s = scenario.column().timing.row_start_s[0]
    np.testing.assert_array_equal(clock.row_start_s, true_s)
    assert true_s[20] - true_s[19] > 5.0
    assert true_s[-1] > (scan.height_px - 1) * scan.row_time_s + 5.0


def test_the_clock_of_a_real_instrument_follows_equation_3(real_samples: Path) -> None:
    """Gxsm4, 700 rows of 700 px over 1787 s; the steps of its float32 values are 0.125 ms at the end."""
    data = (real_samples / "gxsm4" / "clock_ms.npz").read_bytes()
    clock = read_row_clock(data, "clock_ms.npz", 700, 700)
    with np.load(io.BytesIO(data)) as channels:
        measured_s = 1e-3 * channels["time_ms"].astype(np.float64)
    row, column = (place.ravel() for place in np.mgrid[:700, :700])
    own = clock.time_s(column.astype(float), row.astype(float), 0.0).reshape(700, 700)
    assert np.abs(own - measured_s).max() < 0.064e-3
    starts, pixels = np.asarray(clock.row_start_s), np.asarray(clock.pixel_time_s)
    row_time_s, first_s = np.polyfit(np.arange(700), starts, 1)
    assert row_time_s == pytest.approx(2.55378, abs=1e-5)
    assert first_s == pytest.approx(0.60135, abs=1e-5)
    equation_s = first_s + np.arange(700) * row_time_s
    assert np.abs(starts - equation_s).max() < 0.06e-3
    assert pixels.mean() == pytest.approx(2.4299e-3, abs=1e-7)
    assert np.abs(np.add.outer(equation_s, np.arange(700) * pixels.mean()) - measured_s).max() < 0.064e-3
