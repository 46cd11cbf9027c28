"""What the README promises holds: its commands and files exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from semlive.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.checkout


def test_its_commands_exist() -> None:
    known = {command.name for command in app.registered_commands} | {"test"}
    named = set(re.findall(r"(?:go\.py|`semlive|^ {4}semlive) ([a-z]+)", README, re.MULTILINE))
    assert named >= {"demo", "test", "run", "replay"}
    assert named <= known


def test_its_links_lead_somewhere() -> None:
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("https:")]
    assert "docs/flow.svg" in links
    assert not [link for link in links if not (ROOT / link).exists()]
