"""A part of the campaign of faults (docs/reference/faults.md); all of it is `python tests/benchmarks/bench_faults.py`."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "campaign"))
from lab import laboratory
from rows import ROWS
from table import Row

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "faults.md"
LISTED = 55


@pytest.mark.parametrize("row", [row for row in ROWS if row.short], ids=lambda row: f"{row.number}")
def test_what_must_happen_happens(row: Row, tmp_path: Path) -> None:
    with laboratory(tmp_path / "lab") as lab:
        observed = row.run(lab)
    assert observed.what


def test_every_fault_of_the_list_has_its_row_once() -> None:
    numbers = [row.number for row in ROWS]
    # 53 is about clients of the web page, whose own tests hold it.
    assert sorted([*numbers, 53]) == list(range(1, LISTED + 1))


@pytest.mark.checkout
def test_the_page_reports_of_every_row() -> None:
    text = PAGE.read_text(encoding="utf-8")
    reported = {int(number) for number in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)}
    assert reported == {row.number for row in ROWS}
