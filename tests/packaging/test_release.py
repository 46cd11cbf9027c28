"""One version everywhere: pyproject.toml, the package, the citation and the changelog."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import semlive

ROOT = Path(__file__).resolve().parents[2]
VERSION = str(tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"])

pytestmark = pytest.mark.checkout


def test_the_package_has_the_version_of_the_project() -> None:
    assert semlive.__version__ == VERSION


def test_the_citation_has_the_version_of_the_project() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == VERSION
    assert citation["cff-version"] == "1.2.0"
    assert {"title", "message", "authors"} <= citation.keys()


def test_the_newest_release_of_the_changelog_is_the_version_of_the_project() -> None:
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert released
    assert released[0][0] == VERSION
    assert str(yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["date-released"]) == released[0][1]
