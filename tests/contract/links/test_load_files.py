"""Load from a text file that another program writes: the newest complete line by the head's rules, or a message with the reason."""

from __future__ import annotations

import os
import re
import threading
from pathlib import Path

import pytest

from semlive.errors import LinkError, LinkRefused
from semlive_drivers.composite_config import open_load_frame
from semlive_drivers.load_file.part import CsvLoadFile, CsvSettings

from ...clocks import MonotonicClock

FORCE = {"force": {"column": "Force"}, "extension": {"column": "Ext"}}


def tail(path: Path, **settings: object) -> CsvLoadFile:
    return CsvLoadFile(CsvSettings.model_validate({"file": str(path), "frozen_after_s": 100.0, **(settings or FORCE)}), MonotonicClock())


def test_decimal_commas_between_commas_are_no_reading(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_text("Time,Force,Ext\n12,2,134,2,0,5\n")
    with pytest.raises(LinkRefused, match="line 2: has 6 cells under 3 names: the numbers seem to have decimal commas"):
        tail(path)


def test_decimal_commas_that_begin_later_are_no_reading(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_text("Time,Force,Ext\n12,134,0\n")
    file = tail(path)
    assert file.read().force_n == 134.0
    with path.open("a") as grown:
        grown.write("12,4,134,2,0,5\n")
    with pytest.raises(LinkError, match=r"line 3: has 6 cells under 3 names: the numbers seem to have decimal commas"):
        file.read()


@pytest.mark.parametrize(
    "lines",
    ["Time,Force,Ext\n12.4,134.2,0.5\n", "Time;Force (N);Ext [mm]\n12,4;134,2;0,5\n", "Rate: 0,5\n\ntime\tFORCE\text\n12,4\t134,2\t0,5\n"],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_separator_and_decimal_sign_are_found_out(tmp_path: Path, lines: str, encoding: str) -> None:
    path = tmp_path / "load.csv"
    path.write_bytes(lines.encode(encoding))
    printed = tail(path).read()
    assert (printed.force_n, printed.extension_mm) == (134.2, 0.5)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_long_file_is_read_at_its_end_and_half_a_line_never(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "load.csv"
    # In UTF-16 the letter \u0a0a holds the byte of a line feed twice.
    rows = "".join(f"{number / 10:.1f};{number / 10 + 0.25:.2f};0.5;\u0a0a\n" for number in range(20_000))
    path.write_bytes(("Time;Force;Ext;Note\n" + rows).encode(encoding))
    file = tail(path)
    assert file.read().force_n == 2000.15
    with path.open("ab") as grown:
        for part in ("2000.0;13", "4.2", "0;0.5;x\n"):
            assert file.read().force_n == 2000.15
            grown.write(part.encode(encoding.replace("utf-16", "utf-16-le")))
            grown.flush()
    assert file.read().force_n == 134.2


def test_a_unit_in_the_head_counts_where_the_settings_have_none_and_must_not_contradict_them(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_text("Time;Force (kN);Ext (um)\n0,1;0,1342;500,5\n")
    printed = tail(path).read()
    assert (printed.force_n, printed.extension_mm) == (pytest.approx(134.2), pytest.approx(0.5005))
    assert tail(path, force={"column": 2, "unit": "kN"}).read().force_n == pytest.approx(134.2)
    with pytest.raises(LinkRefused, match=r"column 'Force \(kN\)' is in kN, but the settings state N; correct one of them"):
        tail(path, force={"column": 2, "unit": "N"})
    with pytest.raises(LinkRefused, match=r"column 'Ext \(um\)' is in um, which is no unit of force"):
        tail(path, force={"column": 3})


def test_what_can_be_read_in_two_ways_asks_for_the_settings(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_text("Force;Ext\n134,200;7,500\n")
    with pytest.raises(LinkRefused, match=re.escape("'134,200' may mean 134.200 or 134200; specify the decimal sign with")) as error:
        tail(path)
    assert "decimal_comma" in str(error.value)
    assert tail(path, decimal_comma=True, **FORCE).read().force_n == 134.2


def test_a_file_that_is_written_again_is_read_by_its_new_head(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_text("Time;Force;Ext\n0,5;134,2;0,5\n")
    file = tail(path)
    assert file.read().force_n == 134.2
    path.write_text("Force,Ext,Time\n135.2,0.5,0.5\n")
    assert file.read().force_n == 135.2


def test_an_empty_file_waits_for_its_first_line(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_text("")
    file = tail(path)
    for text in ("", "Time;Force;Ext\n", "0,5;134,"):
        with path.open("a") as grown:
            grown.write(text)
        with pytest.raises(LinkError, match="holds no complete line of numbers yet; start the recording"):
            file.read()
    with path.open("a") as grown:
        grown.write("2;0,5\n")
    assert file.read().force_n == 134.2


@pytest.mark.parametrize(("kind", "reason"), [("pipe", "not a regular file"), ("device", "not a regular file"), ("folder", "a folder")])
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, kind: str, reason: str) -> None:
    path = tmp_path / "load.csv"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    errors: list[Exception] = []

    def attempt() -> None:
        try:
            tail(path)
        except LinkRefused as error:
            errors.append(error)

    trial = threading.Thread(target=attempt, daemon=True)
    trial.start()
    trial.join(10.0)
    assert not trial.is_alive()
    assert [str(error) for error in errors] == [f"{path} cannot be read (it is {reason}); check the program that writes it"]


def test_a_line_without_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_text("Time;Force;Ext\n0,5;134,2;0,5\n")
    frame = open_load_frame({"cell": {"protocol": "csv", "file": str(path), "force": {"column": "Force"}}}, MonotonicClock())
    with path.open("a") as grown:
        grown.write("9" * 200_000 + "\n")
    with pytest.raises(LinkError, match="its newest line is longer than"):
        frame.read()
    frame.close()


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"PK\x03\x04" + bytes(64), "is no plain text, but a spreadsheet"),
        (bytes(range(64)) * 2, "is no plain text"),
        (b"Time;Force;Ext\r1;2;3\r4;5;6\r", "end in carriage returns without line feeds"),
    ],
    ids=["spreadsheet", "binary", "carriage returns"],
)
def test_a_file_that_will_never_have_a_line_is_refused_for_that_reason(tmp_path: Path, data: bytes, reason: str) -> None:
    path = tmp_path / "load.csv"
    path.write_bytes(data)
    with pytest.raises(LinkRefused, match=reason):
        tail(path)


def test_space_that_is_reserved_behind_the_last_line_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "load.csv"
    path.write_bytes(b"Time;Force;Ext\n1,5;2,5;3,5\n" + bytes(5000))
    assert tail(path).read().force_n == 2.5
