"""The page of the log's topics names all of them, and no others."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from semlive.data.disparity import PoiStatus
from semlive.formats.log.messages import RAW_TOPICS, TOPICS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "log-topics.md"
COLUMNS = 5

pytestmark = pytest.mark.checkout


def table() -> dict[str, list[str]]:
    """The rows of the table of topics, by topic."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    first = lines.index("| topic | encoding | what | units | sequence |") + 2
    rows: dict[str, list[str]] = {}
    for line in lines[first:]:
        if not line.startswith("|"):
            break
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        topic = cells[0].strip("`")
        assert topic not in rows, f"{topic} is twice in {PAGE.name}"
        rows[topic] = cells
    return rows


def test_every_topic_is_in_the_page_and_every_topic_of_the_page_exists() -> None:
    assert table().keys() == TOPICS.keys() | RAW_TOPICS.keys()


def test_every_row_reports_encoding_units_and_the_meaning_of_the_sequence() -> None:
    for topic, cells in table().items():
        assert len(cells) == COLUMNS, topic
        assert all(cells), topic
        assert cells[1] == RAW_TOPICS.get(topic, "json"), topic
        # Only raw topics keep the sequence that they were given.
        assert (cells[4] == "counts") == (topic not in RAW_TOPICS), topic


def test_every_status_of_a_point_is_in_the_page() -> None:
    (row,) = (line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `/dic/map` | `SLDM`"))
    assert [int(number) for number in re.findall(r"[ :](\d) [a-zA-Z]", row.split("status:")[1])] == [int(item) for item in PoiStatus]


def test_the_text_names_no_topic_that_does_not_exist() -> None:
    named = set(re.findall(r"`(/[a-z_/]+)`", PAGE.read_text(encoding="utf-8")))
    assert named <= TOPICS.keys() | RAW_TOPICS.keys()
