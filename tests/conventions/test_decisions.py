"""Decision pages in docs/decisions have one form, the index is complete, and every link of them and of the explanations resolves."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DECISIONS = ROOT / "docs" / "decisions"
INDEX = DECISIONS / "README.md"
PAGES = sorted(DECISIONS.glob("[0-9]*.md"))
LINKED = [*PAGES, INDEX, *sorted((ROOT / "docs" / "explanations").glob("*.md"))]

HEADINGS = ["Status", "Context", "Decision", "Consequences"]
LENGTH_LINES = range(20, 61)
WIDTH_CHARACTERS = 120
OLD_NUMBERS = range(1, 158)
"""Decisions of the former DESIGN.md."""

pytestmark = pytest.mark.checkout


def page_problems(name: str, text: str) -> list[str]:
    """What is wrong with the form of a decision page.

    Args:
        name: file name, ``NNNN-short-title.md``.
        text: content of the page.
    """
    lines = text.splitlines()
    number = int(name[:4])
    problems: list[str] = []
    if not re.fullmatch(rf"# {number}\. \S.*", lines[0]):
        problems.append(f"the first line is not '# {number}. Title'")
    if re.findall(r"^## (.*)$", text, re.MULTILINE) != HEADINGS:
        problems.append(f"the headings are not {HEADINGS}")
    if any(not part.strip() for part in re.split(r"^## .*$", text, flags=re.MULTILINE)[1:]):
        problems.append("a section is empty")
    if len(lines) not in LENGTH_LINES:
        problems.append(f"{len(lines)} lines, not {LENGTH_LINES.start} to {LENGTH_LINES.stop - 1}")
    if any(len(line) > WIDTH_CHARACTERS for line in lines):
        problems.append(f"a line has more than {WIDTH_CHARACTERS} characters")
    return problems


def indexed(index: str) -> dict[str, str]:
    """Title of each decision in the index, by its four digits."""
    return dict(re.findall(r"^\| \[(\d{4})\] \| (.*) \|$", index, re.MULTILINE))


def old_numbers(index: str) -> dict[int, list[str]]:
    """Labels of the pages that contain each decision of DESIGN.md."""
    rows = re.findall(r"^\| (\d+) \| .* \| (.*) \|$", index, re.MULTILINE)
    return {int(number): re.findall(r"\[([^\]]+)\]", labels) for number, labels in rows}


def definitions(text: str) -> dict[str, str]:
    """Targets of reference links, by label."""
    return dict(re.findall(r"^\[([^\]]+)\]: (\S+)$", text, re.MULTILINE))


def broken_links(path: Path, text: str) -> list[str]:
    """Relative links of a page, of either form, that lead to no file."""
    shown = re.sub(r"^```.*?^```|`[^`\n]*`", "", text, flags=re.DOTALL | re.MULTILINE)
    targets = [*re.findall(r"\]\(([^)\s]+)\)", shown), *definitions(shown).values()]
    files = [target.split("#")[0] for target in targets if not target.startswith(("https:", "http:", "#"))]
    return [file for file in files if not (path.parent / file).is_file()]


def test_numbers_are_consecutive() -> None:
    assert [int(path.name[:4]) for path in PAGES] == list(range(1, len(PAGES) + 1))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_decision_has_the_form(path: Path) -> None:
    assert page_problems(path.name, path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", LINKED, ids=lambda path: path.stem)
def test_links_resolve(path: Path) -> None:
    assert broken_links(path, path.read_text(encoding="utf-8")) == []


def test_the_index_has_every_decision_by_its_title() -> None:
    titles = {path.name[:4]: path.read_text(encoding="utf-8").splitlines()[0].split(". ", 1)[1] for path in PAGES}
    assert indexed(INDEX.read_text(encoding="utf-8")) == titles


def test_every_label_of_the_index_is_defined() -> None:
    text = INDEX.read_text(encoding="utf-8")
    assert {path.name[:4]: path.name for path in PAGES}.items() <= definitions(text).items()
    labels = {label for row in old_numbers(text).values() for label in row}
    assert labels - definitions(text).keys() == set()


def test_every_old_number_has_a_page() -> None:
    pages = old_numbers(INDEX.read_text(encoding="utf-8"))
    assert list(pages) == list(OLD_NUMBERS)
    assert [number for number, labels in pages.items() if not labels] == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda text: text.replace("# 1. ", "# 2. "), "first line"),
        (lambda text: text.replace("## Context", "## Background"), "headings"),
        (lambda text: re.sub(r"## Status\n\n.*?\n\n", "## Status\n\n", text, flags=re.DOTALL), "empty"),
        (lambda text: text + "more\n" * LENGTH_LINES.stop, "lines"),
        (lambda text: text + "x" * (WIDTH_CHARACTERS + 1) + "\n", "characters"),
    ],
    ids=["number", "heading", "empty", "long", "wide"],
)
def test_a_page_of_another_form_is_found(change: Callable[[str], str], problem: str) -> None:
    path = PAGES[0]
    problems = page_problems(path.name, change(path.read_text(encoding="utf-8")))
    assert len(problems) == 1
    assert problem in problems[0]


def test_a_broken_link_is_found() -> None:
    assert broken_links(INDEX, "[a](0000-missing.md) [b](README.md#index) [c](#index)\n\n[d]: ../missing.md\n") == [
        "0000-missing.md",
        "../missing.md",
    ]
