"""Prose uses the standard terms: words that earlier versions used instead of them do not occur.

`banned` takes any text, so that docstrings, messages and identifiers can be checked as well: add their roots to `ROOTS`.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

BANNED = {
    r"told|tells?|telling": "reports, shows",
    r"says?|said|saying": "states, prints, reports",
    r"words?": "message, text, term",
    r"sentences?": "message, status",
    r"(?:is|are|was|were|be|been|being) asked(?: of| about)?": "is tested, is evaluated, is queried",
    r"heard|hears?": "is evaluated, is received",
    r"beside": "with, next to, jointly",
    r"anew|once more|lately": "again, re-, recent",
    r"loud(?:er|est|ly)?": "significant",
    r"quiet(?:er|est|ly)?": "consistent with noise",
    r"what is left|leaves": "residual",
    r"go(?:es)? on|tak(?:e|es|en|ing) up again": "continues, is resumed",
    r"stands|stood": "is stored",
    r"whole": "complete",
    r"torn": "truncated",
    r"the rooms?": "package",
    r"house": "code base",
    r"for good": "permanently",
    r"as large as (?:it is|they are) met": "as large as in practice",
}
"""Pattern of a whole word or phrase, and what to write instead."""

ALLOWED = (
    "word order",
    "order of words",
    "high word",
    "low word",
    "words swapped",
    "20 words",
    "one sentence",
    "per sentence",
    "test stand",
    "test stands",
    "whole number",
    "whole numbers",
    "whole scans",
    "whole seconds",
    "## Words",
)
"""Standard uses, titles of figures of the report, and names of contracts; removed from a text before it is checked."""

ROOTS = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "docs")

_PATTERN = re.compile(r"(?<![\w-])(?:" + "|".join(f"(?:{pattern})" for pattern in BANNED) + r")(?![\w-])", re.IGNORECASE)
_ALLOWED = re.compile(r"(?<![\w-])(?:" + "|".join(map(re.escape, ALLOWED)) + r")(?![\w-])", re.IGNORECASE)

pytestmark = pytest.mark.checkout


def banned(text: str) -> list[str]:
    """Banned words and phrases of a text, in lower case, in their order; empty if there are none.

    Args:
        text: plain text; line breaks count as spaces.
    """
    joined = " ".join(text.split())
    return [match[0].lower() for match in _PATTERN.finditer(_ALLOWED.sub(" ", joined))]


def prose(markdown: str) -> str:
    """The prose of a Markdown page: code, comments, and targets of links and images left out."""
    text = re.sub(r"<!--.*?-->|^```.*?^```", " ", markdown, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^ {4,}\S.*$", " ", text, flags=re.MULTILINE)
    text = re.sub(r"`[^`]*`", " code ", text)
    return re.sub(r"\]\([^)]*\)", "] ", text)


def pages() -> list[Path]:
    """Every Markdown page below the roots."""
    return [path for root in ROOTS for path in ([ROOT / root] if root.endswith(".md") else sorted((ROOT / root).rglob("*.md")))]


@pytest.mark.parametrize("path", pages(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_page_uses_the_standard_terms(path: Path) -> None:
    assert banned(prose(path.read_text(encoding="utf-8"))) == []


def test_there_are_many_pages() -> None:
    assert len(pages()) > 20


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("The daemon says what the data told it.", ["says", "told"]),
        ("It is asked once\nmore, and stands beside the log.", ["is asked", "once more", "stands", "beside"]),
        ("What is left is quiet; the search goes on.", ["what is left", "quiet", "goes on"]),
        ("A torn log is made whole for good.", ["torn", "whole", "for good"]),
    ],
)
def test_a_banned_word_is_found(text: str, found: list[str]) -> None:
    assert banned(text) == found


@pytest.mark.parametrize(
    "text",
    [
        "The word order of two registers, a whole number, a test stand.",
        "Besides, a forecast is not hearsay, and a password is not spoken aloud.",
        "The daemon reports the residual, which is consistent with noise.",
    ],
)
def test_a_standard_term_is_allowed(text: str) -> None:
    assert banned(text) == []


def test_code_is_no_prose() -> None:
    page = "Use `what said`.\n\n    what said\n\n```\nsaid\n```\n\n[term](beside.md) <!-- said -->\n"
    assert banned(prose(page)) == []
    assert banned(prose("It is said.")) == ["said"]
