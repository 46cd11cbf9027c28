"""Instrument and specimen in the text of a report: what is recorded with unit and source, what is not recorded named."""

from __future__ import annotations

from dataclasses import replace

import pytest

from semlive.data.frame import ColumnSettings, FrameInfo, FrameOrigin
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import SpecimenSettings
from semlive.report.sections.instrument import instrument_rows, microscope_text, specimen_text
from semlive.report.sections.wording import NOT_RECORDED


def sourced(value: float) -> Sourced[float]:
    return Sourced(value, Provenance.FILE)


START_NS = 1_795_688_108_158_812_000
COLUMN = ColumnSettings(Sourced("BSED", Provenance.FILE), sourced(30e3), sourced(0.01), None, sourced(0.0))
INFO = FrameInfo(
    3, "a.tif", "fei", 1024, 884, 60, ScanTiming(sourced(1e-4), sourced(0.107), sourced(94.588), Sourced(1, Provenance.FILE)),
    Sourced(START_NS, Provenance.DERIVED), 0.01, Sourced(1.25e-6, Provenance.CONFIG), COLUMN,
)  # fmt: skip


def test_settings_are_prose_with_units() -> None:
    text = microscope_text(INFO, replace(INFO, start_time_ns=Sourced(START_NS + 2_400_000_000_000, Provenance.DERIVED)))
    assert "Frames were recorded from 10:15 to 10:56 UTC on 26 November 2026: acceleration voltage 30 kV, detector BSED" in text
    assert f"magnification {NOT_RECORDED} and working distance 10.00 mm" in text
    assert "A pixel is 1.25 µm wide, the field 1280 µm x 1105 µm" in text
    assert "100 µs on a pixel, a row takes 107 ms, of which 4.6 ms are fly-back, and a scan takes 94.59 s" in text


def test_a_run_over_midnight_has_both_dates() -> None:
    text = microscope_text(INFO, replace(INFO, start_time_ns=Sourced(START_NS + 86_400_000_000_000, Provenance.DERIVED)))
    assert "from 10:15 on 26 November 2026 to 10:16 UTC on 27 November 2026" in text


def test_each_setting_has_its_source() -> None:
    rows = {name: (value, source) for name, value, source in instrument_rows(INFO)}
    assert rows["acceleration voltage"] == ("30 kV", "image file")
    assert rows["pixel size"] == ("1.25 µm", "configuration")
    assert rows["start of the scan"] == ("standard uncertainty 10 ms", "derived from the image file")
    assert rows["magnification, by the convention of the maker"] == (NOT_RECORDED, "-")
    assert rows["model of the microscope"][0] == NOT_RECORDED


def test_missing_values_are_named() -> None:
    without_metadata = replace(INFO, column=ColumnSettings(), pixel_size_m=Sourced(0.0, Provenance.UNKNOWN))
    assert f"The pixel size is {NOT_RECORDED}." in microscope_text(without_metadata)
    assert {name: value for name, value, _ in instrument_rows(without_metadata)}["pixel size"] == NOT_RECORDED
    assert "made from disparity maps of another program" in microscope_text(replace(INFO, vendor=FrameOrigin.IMPORTED))


@pytest.mark.parametrize(
    ("specimen", "text"),
    [
        (SpecimenSettings("AL2024-T4", 10.0), "The specimen is AL2024-T4. Its cross-section of 10 mm² is a configured value"),
        (SpecimenSettings(), f"material of the specimen is {NOT_RECORDED}. Its cross-section is {NOT_RECORDED}"),
    ],
)
def test_a_specimen_is_described_by_what_is_recorded(specimen: SpecimenSettings, text: str) -> None:
    assert text in specimen_text(specimen)
