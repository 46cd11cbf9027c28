"""Messages that the troubleshooting page quotes are messages of the code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "troubleshooting.md"
PACKAGES = ("semlive", "drivers", "simulators")
MIN_WORDS = 3
"""Shorter code spans are names of keys, states and commands."""

pytestmark = pytest.mark.checkout


def strings_of_the_code() -> str:
    """All string constants of the packages and the text of the page's scripts, separated by a character that no message contains."""
    found = [
        node.value
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    found += [path.read_text(encoding="utf-8") for path in (ROOT / "semlive" / "web" / "static").glob("*.js")]
    return "\0".join(found)


def quoted_parts(page: str) -> Iterator[str]:
    """The constant parts of the messages in the first column of every table; `...` replaces a value."""
    for row in re.findall(r"^\| (.*?) \| .*\|$", page, re.MULTILINE):
        for message in re.findall(r"`([^`]+)`", row):
            for part in message.split("..."):
                if len(part.split()) >= MIN_WORDS and not message.startswith("semlive "):
                    yield part.strip()


def test_a_quoted_message_is_a_message_of_the_code() -> None:
    code = strings_of_the_code()
    parts = list(quoted_parts(PAGE.read_text(encoding="utf-8")))
    assert len(parts) > 40
    assert [part for part in parts if part not in code] == []


def test_an_invented_message_is_found() -> None:
    page = "| `...: the folder is made of cheese ...` | cause | remedy |\n"
    assert list(quoted_parts(page)) == [": the folder is made of cheese"]
    assert ": the folder is made of cheese" not in strings_of_the_code()
