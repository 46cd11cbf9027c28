"""What the README promises holds: its commands and files exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from semlive.cli.app import COMMANDS

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.checkout


@pytest.fixture(scope="module")
def readme() -> str:
    return (ROOT / "README.md").read_text(encoding="utf-8")


def test_its_commands_exist(readme: str) -> None:
    commands = {entry.name for entry in COMMANDS} | {"test", "docs"}
    named = set(re.findall(r"(?:go\.py|`semlive|^ {4}semlive) ([a-z]+)", readme, re.MULTILINE))
    assert named >= {"demo", "test", "run", "replay"}
    assert named <= commands


def test_its_links_lead_somewhere(readme: str) -> None:
    links = [link for link in re.findall(r"\]\(([^)]+)\)", readme) if not link.startswith("https:")]
    assert "docs/flow.svg" in links
    assert not [link for link in links if not (ROOT / link).exists()]
