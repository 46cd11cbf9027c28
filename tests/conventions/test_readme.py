"""What the README promises holds: its configuration is valid, its commands and files exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from semlive.cli.app import app
from semlive.service.config import parse_config

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.checkout


def test_its_configuration_is_valid() -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", README, re.DOTALL)
    plan = parse_config(yaml.safe_load(block), "README.md").plan()
    assert len(plan.steps) == 9


def test_its_commands_exist() -> None:
    known = {command.name for command in app.registered_commands} | {"test"}
    named = set(re.findall(r"(?:go\.py|`semlive) ([a-z]+)", README))
    assert named >= {"demo", "test", "run", "replay"}
    assert named <= known


def test_its_links_lead_somewhere() -> None:
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("https:")]
    assert "docs/flow.svg" in links
    assert not [link for link in links if not (ROOT / link).exists()]
