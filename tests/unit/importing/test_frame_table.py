"""`frames.csv`: errors name file, line and column."""

from __future__ import annotations

import re

import pytest

from semlive.data.experiment import Phase
from semlive.errors import BadInput
from semlive.formats.tables.frame_table import read_frame_table

HEADER = "frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px"
GOOD = [
    "0,0,calibration,0.0,1e-5,0.0110,1000,800,1,,0,0",
    "1,0,calibration,10.0,1e-5,0.0110,1000,800,1,,0,0",
    "2,1,tension,30.0,1e-5,0.0110,1000,800,1,250.5,,",
    "3,1,tension,40.0,1e-5,0.0110,1000,800,1,250.5,,",
]


def read(lines: list[str], header: str = HEADER):
    return read_frame_table("\n".join([header, *lines, ""]).encode(), "frames.csv")


def test_good_lines_are_read_in_the_order_of_frames_whatever_their_own() -> None:
    rows = read(GOOD[::-1])
    assert [row.frame for row in rows] == [0, 1, 2, 3]
    assert rows[2].phase is Phase.TENSION
    assert rows[2].load_n == 250.5
    assert rows[2].shift_px is None
    assert rows[0].shift_px == (0.0, 0.0)
    assert rows[0].end_s == pytest.approx(8.8)


def test_spreadsheets_write_a_mark_carriage_returns_quotes_and_blank_lines() -> None:
    text = "\r\n".join(['"' + HEADER.replace(",", '","') + '"', *GOOD, "", ",,,,,,,,,,,", ""])
    assert len(read_frame_table(b"\xef\xbb\xbf" + text.encode(), "frames.csv")) == 4


def test_further_columns_do_no_harm_and_a_strain_gage_is_read() -> None:
    rows = read([f"{line},{'' if '250' not in line else '1e-3'},tif" for line in GOOD], HEADER + ",gage_strain,file")
    assert rows[3].gage_strain == 1e-3


def test_a_strain_gage_may_be_read_without_load_in_pairs_that_are_not_loaded() -> None:
    assert [row.gage_strain for row in read([f"{line},1e-3" for line in GOOD], HEADER + ",gage_strain")] == [1e-3] * 4


def test_names_with_units_and_marks_of_lost_values_are_read() -> None:
    header = HEADER.replace("start_s", "Start [s]").replace("load_n", "load (N)").replace("row_time_s", "row-time-s")
    rows = read([line.replace(",1,,", ",1,missing,").replace("250.5,,", "250.5,#N/A,#N/A") for line in GOOD], header)
    assert [(row.start_s, row.load_n, row.shift_px) for row in rows] == [(row.start_s, row.load_n, row.shift_px) for row in read(GOOD)]


WRONG = {
    "missing column": (HEADER.replace(",row_time_s", ""), GOOD, "line 1: column row_time_s is missing"),
    "unit": (HEADER.replace("dwell_s", "dwell (us)"), GOOD, "line 1: column dwell (us) is in us; give dwell_s in s"),
    "kilonewtons": (HEADER.replace("load_n", "Load_kN"), GOOD, "line 1: column Load_kN is in kN; give load_n in N"),
    "column twice": (HEADER + ",frame", GOOD, "line 1: column frame occurs twice"),
    "no lines": (HEADER, [], "line 2: holds no frame"),
    "unknown phase": (
        HEADER,
        [GOOD[0].replace("calibration", "kalibration"), *GOOD[1:]],
        "line 2, column phase: 'kalibration' is no phase",
    ),
    "nan": (HEADER, [GOOD[0], GOOD[1].replace("10.0", "nan"), *GOOD[2:]], "line 3, column start_s: is nan"),
    "word": (HEADER, [GOOD[0], GOOD[1].replace("10.0", "ten"), *GOOD[2:]], "line 3, column start_s: 'ten' is not a number"),
    "empty": (HEADER, [GOOD[0], GOOD[1].replace("10.0", ""), *GOOD[2:]], "line 3, column start_s: is empty"),
    "short line": (HEADER, [*GOOD[:3], "3,1,tension,40.0"], "line 5: has 4 cells under 12 names, separated by commas"),
    "microseconds": (
        HEADER,
        [GOOD[0].replace("1e-5", "10"), *GOOD[1:]],
        "line 2, column dwell_s: 10 is beyond the range of scans; give it in seconds",
    ),
    "row shorter than its pixels": (
        HEADER,
        [GOOD[0].replace("0.0110", "0.0011"), *GOOD[1:]],
        "line 2, column row_time_s: 0.0011 s is shorter",
    ),
    "milliseconds": (
        HEADER,
        [line.replace("0.0110", "11.0") for line in GOOD],
        "line 3, column start_s: frame 1 starts at 10 s, before frame 0 ends",
    ),
    "times fall": (
        HEADER,
        [*GOOD[:2], GOOD[2].replace("30.0", "50.0"), GOOD[3]],
        "line 5, column start_s: frame 3 starts at 40 s, not after",
    ),
    "frame twice": (HEADER, [*GOOD, GOOD[3]], "line 6, column frame: frame 3 is in line 5 already"),
    "frame of another pair": (
        HEADER,
        [*GOOD[:3], GOOD[3].replace("3,1", "3,2")],
        "line 5, column pair: is 2 but frame 3 belongs to pair 1",
    ),
    "half a pair": (HEADER, GOOD[:3], "line 4, column pair: pair 1 has no frame 3"),
    "no pair 0": (HEADER, GOOD[2:], "line 2, column frame: the first frame is 2; begin with pair 0"),
    "phases of a pair": (HEADER, [*GOOD[:3], GOOD[3].replace("tension", "translation")], "line 5, column phase: translation but frame 2"),
    "one load": (HEADER, [*GOOD[:3], GOOD[3].replace("250.5", "")], "line 5, column load_n: is empty but the pair's other frame has one"),
    "one shift": (HEADER, [GOOD[0].removesuffix("0"), *GOOD[1:]], "line 2, column shift_y_px: is empty but the other axis is not"),
    "size": (HEADER, [GOOD[0], GOOD[1].replace("1000", "999"), *GOOD[2:]], "line 3, column width: is 999 but frame 0 has 1000"),
    "half an integration": (HEADER, [GOOD[0].replace(",1,,", ",1.5,,"), *GOOD[1:]], "line 2, column integrations: 1.5 is no integer"),
    "a load that marks a missing one": (
        HEADER,
        [line.replace("250.5", "-9999") for line in GOOD],
        "line 4, column load_n: -9999 may be a value or mark a missing one; leave the cell empty",
    ),
    "a shift longer than the frame": (HEADER, [GOOD[0].replace(",0,0", ",0,4000"), *GOOD[1:]], "column shift_y_px: 4000 px is longer than"),
    "a gage in microstrain": (HEADER + ",gage_strain", [f"{line},125" for line in GOOD], "give it in strain, 1e-6 for one microstrain"),
    "microseconds in the name": (HEADER.replace("dwell_s", "dwell_us"), GOOD, "column dwell_us is in us; give dwell_s in s"),
    "gage without load": (
        HEADER + ",gage_strain",
        [f"{line},1e-3".replace("250.5", "") for line in GOOD],
        "line 4, column load_n: is empty but gage_strain",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_an_error_is_reported_with_its_place(name: str) -> None:
    header, lines, printed = WRONG[name]
    with pytest.raises(BadInput, match=re.escape(printed)) as wrong:
        read(lines, header)
    assert str(wrong.value).startswith("frames.csv: ")
    assert "\n" not in str(wrong.value)
    assert "; " in str(wrong.value)  # what to do
