"""Docstrings, comments, messages and identifiers of the product use the standard terms.

Print the places of a folder or file with `python tests/conventions/test_plain_english_code.py semlive/engine`.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from measure import BANNED as BANNED_IDENTIFIERS
from measure import PRODUCT, names
from test_plain_english import banned

ROOT = Path(__file__).resolve().parents[2]

CONTRACT_NAMES: frozenset[str] = frozenset({"say", "heard", "tell", "RATE_NOT_KEPT", "sutton_phases_apart"})
"""Identifiers that other programs rely on: keys of JSON, of logs and of the configuration, methods of Python files."""

CONTRACT_FIELDS = {"semlive/web/page_state.py": {"wanted", "told", "desk"}}
"""Identifiers of one module that are keys of the JSON which the live page reads."""

pytestmark = pytest.mark.checkout

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def prose(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of every comment and every string that holds more than one word."""
    comment, first = "", 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comment, first = f"{comment} {token.string.lstrip('# ')}", first or token.start[0]
        elif token.type not in (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT) and comment:
            yield first, comment
            comment, first = "", 0
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
            yield node.lineno, re.sub(r"`[^`]*`", " code ", node.value)


def identifiers(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of every identifier with a banned word; *left* is a direction where *right* is used, too."""
    for node in ast.walk(ast.parse(source)):
        for name in names(node):
            words = {word.lower() for word in _WORD.findall(name)}
            found = words & BANNED_IDENTIFIERS
            if "left" in found and re.search(r"right|lower|upper", source):
                found = found - {"left"}
            if found and name not in CONTRACT_NAMES:
                yield getattr(node, "lineno", 0), name


def found(path: Path) -> list[str]:
    """One line for each place of a file that does not use the standard terms."""
    source = path.read_text(encoding="utf-8")
    texts = [f"{line}: {word!r} in a text" for line, text in prose(source) for word in banned(text)]
    fields = CONTRACT_FIELDS.get(path.resolve().relative_to(ROOT).as_posix(), set[str]())
    return texts + [f"{line}: name {name}" for line, name in identifiers(source) if name not in fields]


def modules() -> list[Path]:
    """Every module of the product."""
    return [path for root in PRODUCT for path in sorted((ROOT / root).rglob("*.py"))]


def test_modules_use_the_standard_terms() -> None:
    assert len(modules()) > 500
    assert [f"{path.relative_to(ROOT)}:{place}" for path in modules() for place in found(path)] == []


def test_texts_and_names_are_found() -> None:
    source = 'def told_of(left_over: int) -> str:\n    """It says it."""\n    kept = f"{left_over} heard anew"  # once\n    # more\n'
    assert sorted((line, word) for line, text in prose(source) for word in banned(text)) == [
        (2, "says"),
        (3, "anew"),
        (3, "heard"),
        (3, "once more"),
    ]
    assert list(identifiers(source)) == [(1, "told_of"), (1, "left_over"), (3, "kept")]


if __name__ == "__main__":
    for name in sys.argv[1:]:
        for path in sorted(Path(name).rglob("*.py")) if Path(name).is_dir() else [Path(name)]:
            sys.stdout.writelines(f"{path}:{place}\n" for place in found(path))
