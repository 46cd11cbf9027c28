"""docs/how-to/safety.md names every fault code, and no other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from semlive.data.faults import FaultCode
from semlive.engine.supervision.load_change import RATE_FACTOR
from semlive.engine.supervision.load_response import ARRIVED_AND_MOVING_S
from semlive.engine.supervision.ramp_readings import MAX_UNVERIFIED_S, STARTING_S
from semlive.engine.supervision.standstill import UNORDERED_MOTION_S
from semlive.engine.supervision.stop_distance import FASTEST_FACTOR
from semlive.engine.supervision.travel_response import STANDSTILL_S
from semlive.service.device_link.stop_pursuit import DISOBEYED_S

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "safety.md"

pytestmark = pytest.mark.checkout


def rows(heading: str) -> list[str]:
    """First cells of the table below a heading."""
    section = PAGE.read_text(encoding="utf-8").split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)


def test_the_table_of_codes_is_the_enumeration() -> None:
    assert rows("All codes") == [code.value for code in FaultCode]


def test_the_rules_have_codes_of_the_enumeration() -> None:
    named = rows("While a ramp is under way") + rows("While nothing is ordered")
    assert len(named) > 15
    assert set(named) <= {code.value for code in FaultCode}


@pytest.mark.parametrize("code", ["would_unload", "loaded_at_start", "stop_not_obeyed", "link_lost", "control_lost", "foreign_order"])
def test_a_section_explains_what_is_no_rule_of_a_ramp(code: str) -> None:
    assert f"`{code}`" in PAGE.read_text(encoding="utf-8").split("\n## All codes\n")[0]


def test_figures_are_those_of_the_code() -> None:
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    for words in (
        f"at most {MAX_UNVERIFIED_S:g} s of the ramp",
        f"of {STARTING_S:g} s of the ramp",
        f"for {STANDSTILL_S:g} s after the extension followed it",
        f"more than {RATE_FACTOR:g} times what was ordered",
        f"motion for {ARRIVED_AND_MOVING_S:g} s more",
        f"motion for more than {UNORDERED_MOTION_S:g} s",
        f"After {DISOBEYED_S:g} s without that",
        f"more than {FASTEST_FACTOR:g} times the ordered rate",
    ):
        assert words in text, words
