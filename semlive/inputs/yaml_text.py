"""Strict YAML 1.2: one document, every key once, and no value that two readers would interpret differently.

The scanner and parser are those of ruamel.yaml; this module builds the values, with their lines and without implicit conversions.
Text that older YAML readers interpret as an octal number, a sexagesimal number, a truth value or an infinity is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionStartEvent,
    DocumentStartEvent,
    Event,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
    StreamEndEvent,
    StreamStartEvent,
)

from semlive.errors import BadConfig

MOST_BYTES = 1_000_000
"""Largest size of a YAML file; configurations and device descriptions have a few kB."""
MOST_NESTED = 32
"""Largest depth of nested lists and mappings; a configuration has 6."""
MOST_VALUES = 200_000
"""Largest number of values, with repetitions by aliases (ten aliases of ten aliases, nine times, are 10^9)."""

Place = tuple[str | int, ...]
"""Keys and list indexes that lead to a value."""

_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_RADIX = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_WORDS: dict[str, bool | None] = {"": None, "~": None}
_WORDS |= dict.fromkeys(("null", "Null", "NULL"), None)
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_LONGEST_NUMBER = 64

_TRUTH_WORDS = re.compile(r"yes|Yes|YES|no|No|NO|on|On|ON|off|Off|OFF")
# Pattern, and advice; the first pattern that fits is used.
_DOUBTFUL_NUMBERS = (
    (re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"), "is not a finite number; write a number, or leave the key out"),
    (
        re.compile(r"[-+]?0[0-9][0-9_]*(\.[0-9_]*)?([eE][-+]?[0-9]+)?"),
        "begins with a zero, which may mean octal; leave the zero out, or put text in quotes",
    ),
    (re.compile(r"[-+]?[0-9.]*[0-9]_[0-9_.]*([eE][-+]?[0-9_]+)?"), "has an underscore between digits; leave it out, or put text in quotes"),
    (re.compile(r"[-+]?[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?"), "may be a number to base 60; write one number, or put text in quotes"),
    (re.compile(r"[-+]?[0-9]+(,[0-9]+)+(\.[0-9]+)?"), "has a comma between digits; write a decimal point, or a list as [1, 2]"),
    (
        re.compile(r"[-+]0[ox][0-9a-fA-F]+|[-+]?0b[01_]+"),
        "is not a number of YAML 1.2; write it with decimal digits, or put text in quotes",
    ),
)


@dataclass(frozen=True, slots=True)
class YamlText:
    """Content of a YAML text.

    Attributes:
        value: dictionaries, lists, text, integers, finite numbers, truth values and None.
        lines: line of each value by its place, from 1; for the value of a key, the line of the key.
    """

    value: object
    lines: Mapping[Place, int]

    def line(self, place: Place) -> int | None:
        """Return the line of a place, or of the innermost value that contains it; None if there is none."""
        for count in range(len(place), 0, -1):
            if (line := self.lines.get(tuple(place[:count]))) is not None:
                return line
        return None


def read_yaml(text: str | bytes, where: str) -> YamlText:
    """Parse a YAML text strictly.

    Args:
        text: text of one document; bytes are UTF-8.
        where: name of the file, for error messages.

    Raises:
        BadConfig: the text is too large or too deeply nested, is not YAML, has a key twice, or has an ambiguous value.
    """
    if len(text) > MOST_BYTES:
        raise BadConfig(f"{where}: is larger than {MOST_BYTES / 1e6:g} MB; give a smaller YAML file")
    if isinstance(text, bytes):
        try:
            text = text.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = text.count(b"\n", 0, error.start) + 1
            raise BadConfig(f"{where}: line {line}: is not UTF-8 text; save the file as UTF-8") from error
    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 2)
    builder = _Builder(text, where)
    try:
        return builder.document(iter(reader.parse(text)))
    except YAMLError as error:
        raise BadConfig(f"{where}: {_reason(error, text)}") from error
    except (ValueError, RecursionError) as error:  # such as an escape for a character that does not exist
        raise BadConfig(f"{where}: is not YAML ({error}); correct it") from error


def _reason(error: YAMLError, text: str) -> str:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    line = text.count("\n", 0, getattr(error, "position", 0)) + 1 if mark is None else mark.line + 1
    rows = text.splitlines()
    row = rows[line - 1] if 0 < line <= len(rows) else ""
    if "\t" in row[: len(row) - len(row.lstrip())]:
        return f"line {line} is indented with a tab; use spaces"
    return f"line {line} is not YAML; check its indentation and colons"


@dataclass(slots=True)
class _Node:
    """A value with the lines of the values inside it, by places relative to it."""

    value: object
    line: int
    end: int
    number: bool = False
    lines: dict[Place, int] = field(default_factory=dict)
    values: int = 1


class _Builder:
    """Builds values from the events of the parser."""

    def __init__(self, text: str, where: str) -> None:
        self._text, self._where = text, where
        self._anchors: dict[str, _Node] = {}
        self._values = 0

    def document(self, events: Iterator[Event]) -> YamlText:
        """Return the only document of the text."""
        node: _Node | None = None
        for event in events:
            if isinstance(event, DocumentStartEvent):
                if node is not None:
                    self._refuse(_line(event), (), "a second document begins; keep one document in the file")
                if event.version not in (None, (1, 2)):
                    self._refuse(_line(event), (), "only YAML 1.2 is read; remove the %YAML line")
                node = self._node(next(events), events, ())
            elif isinstance(event, StreamStartEvent | StreamEndEvent):
                continue
        return YamlText(None, {}) if node is None else YamlText(node.value, node.lines)

    def _node(self, event: Event, events: Iterator[Event], place: Place) -> _Node:
        line = _line(event)
        if isinstance(event, AliasEvent):
            node = self._anchors.get(str(event.anchor))
            if node is None:
                self._refuse(line, place, f"*{event.anchor} repeats a value that is not complete yet; write the values out")
            self._count(node.values, line, place)
            return _Node(node.value, line, event.end_mark.index, node.number, dict(node.lines), node.values)
        assert isinstance(event, NodeEvent)  # the parser gives no other event where a node begins
        tag = getattr(event, "tag", None) or getattr(event, "ctag", None)
        if tag is not None and str(tag) not in ("None", "!"):
            self._refuse(line, place, f"the tag {tag} is not read; remove it")
        self._count(1, line, place)
        if isinstance(event, ScalarEvent):
            node = self._scalar(event, line, place)
        else:
            assert isinstance(event, CollectionStartEvent)  # as above
            if len(place) >= MOST_NESTED:
                self._refuse(line, place[:4], f"is nested more than {MOST_NESTED} deep; correct the brackets or the indentation")
            node = (
                self._mapping(events, line, place) if isinstance(event, MappingStartEvent) else self._sequence(event, events, line, place)
            )
        if event.anchor is not None:
            self._anchors[str(event.anchor)] = node
        return node

    def _count(self, more: int, line: int, place: Place) -> None:
        self._values += more
        if self._values > MOST_VALUES:
            self._refuse(line, place, f"more than {MOST_VALUES} values, those repeated by aliases included; write less")

    def _mapping(self, events: Iterator[Event], line: int, place: Place) -> _Node:
        mapping: dict[Any, object] = {}
        node = _Node(mapping, line, 0)
        while isinstance(event := next(events), NodeEvent):
            if not isinstance(event, ScalarEvent):
                self._refuse(_line(event), place, "a key must be text or an integer; write key: value")
            key, key_line = self._key(event, place), _line(event)
            inside = (*place, key)
            if key in mapping:
                self._refuse(key_line, inside, f"is there already, in line {node.lines[(key,)]}; keep one of the two")
            value = self._node(next(events), events, inside)
            mapping[key] = value.value
            self._note(node, key, value, key_line)
        return node

    def _key(self, event: ScalarEvent, place: Place) -> str | int:
        if event.value == "<<" and event.style in (None, ""):
            self._refuse(_line(event), place, "<< merges keys in YAML 1.1 only; write the keys out")
        plain = event.style in (None, "")
        if plain and _INTEGER.fullmatch(event.value) and len(event.value) <= _LONGEST_NUMBER:
            return int(event.value)
        if plain and _RADIX.fullmatch(event.value):
            return int(event.value, 0)
        if plain and (event.value in _WORDS or _FLOAT.fullmatch(event.value)):
            self._refuse(_line(event), place, f"{event.value or 'nothing'} is not allowed as a key; write text, or put it in quotes")
        if plain:
            self._refuse_doubtful_number(str(event.value), _line(event), place)
        return str(event.value)

    def _sequence(self, start: CollectionStartEvent, events: Iterator[Event], line: int, place: Place) -> _Node:
        assert isinstance(start, SequenceStartEvent)  # the only other collection
        items: list[object] = []
        node = _Node(items, line, 0)
        before: _Node | None = None
        while not isinstance(event := next(events), SequenceEndEvent):
            begin = event.start_mark.index
            item = self._node(event, events, (*place, len(items)))
            if start.flow_style and before is not None and before.number and item.number and begin == before.end + 1:
                pair = self._text[: item.end].rsplit("[", 1)[-1]
                self._refuse(item.line, place, f"{pair} may be one number or several; write a decimal point, or a space behind the comma")
            self._note(node, len(items), item, item.line)
            items.append(item.value)
            before = item
        return node

    @staticmethod
    def _note(node: _Node, key: str | int, value: _Node, line: int) -> None:
        node.lines[(key,)] = line
        for inner, inner_line in value.lines.items():
            node.lines[(key, *inner)] = inner_line
        node.values += value.values

    def _scalar(self, event: ScalarEvent, line: int, place: Place) -> _Node:
        text, end = str(event.value), event.end_mark.index
        if event.style not in (None, ""):
            return _Node(text, line, end)
        if text in _WORDS:
            return _Node(_WORDS[text], line, end)
        if (_INTEGER.fullmatch(text) or _FLOAT.fullmatch(text)) and len(text) > _LONGEST_NUMBER:
            self._refuse(line, place, f"a number of {len(text)} digits; write it shorter")
        if _INTEGER.fullmatch(text):
            return _Node(int(text), line, end, True)
        if _RADIX.fullmatch(text):
            return _Node(int(text, 0), line, end, True)
        if _FLOAT.fullmatch(text):
            value = float(text)
            if not math.isfinite(value):
                self._refuse(line, place, f"{text} is beyond the range of numbers; correct it")
            return _Node(value, line, end, True)
        if _TRUTH_WORDS.fullmatch(text):
            self._refuse(line, place, f"{text} may be a truth value or text; write true or false, or put text in quotes")
        self._refuse_doubtful_number(text, line, place)
        return _Node(text, line, end)

    def _refuse_doubtful_number(self, text: str, line: int, place: Place) -> None:
        for form, advice in _DOUBTFUL_NUMBERS:
            if form.fullmatch(text):
                self._refuse(line, place, f"{text} {advice}")

    def _refuse(self, line: int, place: Place, what: str) -> NoReturn:
        key = ".".join(str(part) for part in place)
        raise BadConfig(f"{self._where}: line {line}: {key}{': ' if key else ''}{what}")


def _line(event: Event) -> int:
    return event.start_mark.line + 1
