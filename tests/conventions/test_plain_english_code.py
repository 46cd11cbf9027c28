"""Docstrings, comments, messages and identifiers of the product and of the tests use the standard terms.

Print the places of a folder or file with `python tests/conventions/test_plain_english_code.py semlive/engine`.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from measure import CONTRACT_FIELDS, CONTRACT_NAMES, PRODUCT, banned_words, names
from test_plain_english import banned

ROOT = Path(__file__).resolve().parents[2]

CONTRACT_KEYS = r"\b(?:tells|says|words|said)(?=:| names\b)|#words\b|/say\b|\"say\"|\bstate-word\b"
"""Keys of device maps, of stored observations and of the live page's requests, and two anchors of pages, in texts of the tests."""

NO_PROSE = (
    "tests/conventions/measure.py",
    "tests/conventions/test_plain_english.py",
    "tests/conventions/test_plain_english_code.py",
)
"""Modules that list the banned terms."""

TEST_NAMES = re.compile(
    r"\b(?:sees|saw|hears|knows|wants|believe[sd]?|remembers|forgets|foretells?|seldom|speaks?|feigns?|swallows?|honest|sentences?"
    r"|strangers?|riddles?|begun|foreseen|deaf|impatient|in vain)\b"
)
"""Terms that the name of a test does not use, besides those of texts."""

pytestmark = pytest.mark.checkout


@lru_cache(maxsize=1)
def _nodes(source: str) -> tuple[ast.AST, ...]:
    """Every node of a module; kept for the next question about the same source, because parsing takes most of the time."""
    return tuple(ast.walk(ast.parse(source)))


def _comments(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of every comment; comments of successive lines are one. Tokens are read only where the result matters."""
    if not banned(" ".join(re.findall(r"#(.*)", source))):
        return
    comment, first = "", 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comment, first = f"{comment} {token.string.lstrip('# ')}", first or token.start[0]
        elif token.type not in (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT) and comment:
            yield first, comment
            comment, first = "", 0


def prose(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of every comment with a banned term, and of every string that holds more than one word."""
    yield from _comments(source)
    for node in _nodes(source):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
            yield node.lineno, re.sub(r"`[^`]*`", " code ", node.value)


def identifiers(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of every identifier with a banned word; *left* is a direction where *right* is used, too."""
    for node in _nodes(source):
        for name in names(node):
            found = banned_words(name)
            if "left" in found and re.search(r"right|lower|upper", source):
                found = found - {"left"}
            if found and name not in CONTRACT_NAMES:
                yield getattr(node, "lineno", 0), name


def names_of_tests(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of every test whose name, read as a text, uses a banned term."""
    for node in _nodes(source):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            text = node.name.replace("_", " ")
            if banned(text) or TEST_NAMES.search(text):
                yield node.lineno, node.name


def found(path: Path) -> list[str]:
    """One line for each place of a file that does not use the standard terms."""
    source, place = path.read_text(encoding="utf-8"), path.resolve().relative_to(ROOT).as_posix()
    keys = CONTRACT_KEYS if place.startswith("tests/") else r"(?!)"
    texts = [f"{line}: {word!r} in a text" for line, text in prose(source) for word in banned(re.sub(keys, " ", text))]
    fields = CONTRACT_FIELDS.get(place, set[str]())
    tests = names_of_tests(source) if place.startswith("tests/") else ()
    return texts + [f"{line}: name {name}" for line, name in (*identifiers(source), *tests) if name not in fields]


def modules() -> list[Path]:
    """Every module of the product."""
    return [path for root in PRODUCT for path in sorted((ROOT / root).rglob("*.py"))]


def test_modules_use_the_standard_terms() -> None:
    assert len(modules()) > 500
    assert [f"{path.relative_to(ROOT)}:{place}" for path in modules() for place in found(path)] == []


def modules_of_tests() -> list[Path]:
    """Every module of the tests that is checked."""
    paths = {path.relative_to(ROOT).as_posix(): path for path in sorted((ROOT / "tests").rglob("*.py"))}
    return [path for place, path in paths.items() if place not in NO_PROSE]


def test_tests_use_the_standard_terms() -> None:
    assert len(modules_of_tests()) > 400
    assert [f"{path.relative_to(ROOT)}:{place}" for path in modules_of_tests() for place in found(path)] == []


def test_texts_and_names_are_found() -> None:
    source = 'def told_of(left_over: int) -> str:\n    """It says it."""\n    kept = f"{left_over} heard anew"  # once\n    # more\n'
    assert sorted((line, word) for line, text in prose(source) for word in banned(text)) == [
        (2, "says"),
        (3, "anew"),
        (3, "heard"),
        (3, "once more"),
    ]
    assert list(identifiers(source)) == [(1, "told_of"), (1, "left_over"), (3, "kept")]


def test_names_of_tests_are_found() -> None:
    source = "def test_a_whole_file_is_read(): ...\ndef test_it_sees_a_step(): ...\ndef test_a_step_is_detected(): ...\n"
    assert list(names_of_tests(source)) == [(1, "test_a_whole_file_is_read"), (2, "test_it_sees_a_step")]


if __name__ == "__main__":
    for name in sys.argv[1:]:
        for path in sorted(Path(name).rglob("*.py")) if Path(name).is_dir() else [Path(name)]:
            sys.stdout.writelines(f"{path}:{place}\n" for place in found(path))
