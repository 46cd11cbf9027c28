"""Headers of any text, and damaged files of every vendor: nothing but BadInput comes out, soon."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from fuzz_formats import PROFILES, Tally, campaign, seeds
from hypothesis import given, settings
from hypothesis import strategies as st

from semlive.errors import BadInput
from semlive.formats.images.frame_metadata import fill_missing
from semlive.formats.images.frames import read_sidecar
from semlive.formats.images.inspection import as_json, inspect_sidecar
from semlive.formats.metadata.header import Header
from semlive.formats.metadata.quantity import quantity
from semlive.formats.metadata.timestamps import dated, iso
from semlive.formats.vendors import fei, hitachi, jeol, tescan, zeiss
from semlive.service.watch.accepted_files import FileNumbering

NOW_NS = 1_772_439_825 * 10**9
ZEISS = ("AP_LINE_TIME", "AP_FRAME_TIME", "AP_DATE", "AP_TIME", "AP_LINE_COUNTER", "DP_NOISE_REDUCTION", "AP_IMAGE_PIXEL_SIZE")
TESCAN = ("DwellTime", "PixelSizeX", "PixelSizeY", "ImageStripSize", "AccFrames", "Date", "Time", "ScanSpeed")
JEOL = ("$CM_FULL_SIZE", "$CM_MAG", "$$SM_MICRON_BAR", "$$SM_MICRON_MARKER", "$CM_DATE", "$CM_TIME", "$$SM_INTEG_NO")
KEYS = st.sampled_from((*ZEISS, "AP_LINE_AVERAGE_COUNT", *TESCAN, *JEOL, "DataSize", "PixelSize", "InstructName", "Dwell", "LineTime"))
VALUES = st.one_of(
    st.text(max_size=20),
    st.sampled_from(
        ["0", "-1", "1e308", "nan", "inf", "9" * 70, "0e9999", "1e-9999", "Line Int. Busy", "1024 * 768", "1 1", "0x0", "00:00:00"]
    ),
    st.floats().map(str),
    st.integers().map(str),
)
LINES = st.lists(st.tuples(KEYS, VALUES), max_size=12)


@contextmanager
def soon() -> Iterator[None]:
    """Two seconds of this process's own time at most: what other programs take of the computer does not count."""
    began_s = time.process_time()
    yield
    assert time.process_time() - began_s < 2.0


def _resolved(header: Header | None) -> None:
    if header is None:
        return
    for profile in PROFILES:
        height_px, printed = 1, "a.tif"
        try:
            height_px = fill_missing("a.tif", header, 64, 48, profile).height_px
        except BadInput as refusal:
            printed = str(refusal)
        assert 1 <= height_px <= 48
        assert "a.tif" in printed


@settings(max_examples=150)
@given(LINES, st.sampled_from(["=", " = ", " ", "\n", "\r\nx = "]))
def test_any_header_is_read_or_passed_over(lines: list[tuple[str, str]], mark: str) -> None:
    text = "\r\n".join(f"{key}{mark}{value}" for key, value in lines)
    raw = text.encode("utf-16" if len(text) % 2 else "utf-8", errors="replace")
    with soon():
        _resolved(zeiss.header(zeiss.parse(text), 64, 48))
        _resolved(fei.header(fei.FeiText(fei.parse_ini("[EScan]\n" + text), fei.parse_xml(text))))
        _resolved(tescan.header(tescan.parse_tag(raw)))
        _resolved(jeol.header({key: value for key, value in lines}))
        _resolved(hitachi.header(dict(lines), NOW_NS))
        _resolved(read_sidecar(raw, NOW_NS))
        alone = inspect_sidecar("a.txt", raw, NOW_NS, PROFILES[1])
        json.dumps(None if alone is None else as_json(alone, "a.txt"), allow_nan=False)


@settings(max_examples=150)
@given(st.text(max_size=30), st.text(max_size=20))
def test_any_number_date_and_name_is_one_or_none(text: str, other: str) -> None:
    with soon():
        found = quantity(text)
        assert found is None or np.isfinite(found.value)
        iso(text)
        for order in ("dmy", "mdy", "ymd"):
            dated(text, order, other)
        FileNumbering().check_gap(text)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_short_campaign_of_damaged_files_ends_without_a_crash(seed: int) -> None:
    failed: list[BaseException] = []
    tally = Tally()
    campaign(400, seed, seeds(), lambda _data, _sidecar, error: failed.append(error), 10.0, tally)
    assert failed == []
    assert tally.inputs == 400
    assert tally.read > 20
