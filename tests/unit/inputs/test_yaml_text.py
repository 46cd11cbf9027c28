"""Strict YAML: what is read, and what is refused with its line."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from semlive.errors import BadConfig
from semlive.inputs.yaml_text import MOST_BYTES, MOST_NESTED, read_yaml

ROOT = Path(__file__).parents[3]
TEN_OF_TEN = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))


def refusal(text: str | bytes) -> str:
    with pytest.raises(BadConfig) as error:
        read_yaml(text, "run.yaml")
    printed = str(error.value)
    assert printed.startswith("run.yaml: ")
    assert "\n" not in printed
    return printed


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: 1e-5", 1e-5),
        ("a: 1.", 1.0),
        ("a: .5", 0.5),
        ("a: -3", -3),
        ("a: +5", 5),
        ("a: 0x1F", 31),
        ("a: 0o17", 15),
        ("a: 0", 0),
        ("a: 0.5", 0.5),
        ("a: true", True),
        ("a: ~", None),
        ("a:", None),
        ("a: y", "y"),
        ("a: 'yes'", "yes"),
        ("a: '0300'", "0300"),
        ("a: 2024-01-05", "2024-01-05"),
        ("a: 192.168.100.200", "192.168.100.200"),
        ("a: [30, 5]", [30, 5]),
        ("a: {x: 1,y: 2}", {"x": 1, "y": 2}),
        ("\ufeffa: 1", 1),
    ],
)
def test_values_are_those_of_yaml_1_2(text: str, value: object) -> None:
    read = read_yaml(text.encode(), "run.yaml").value
    assert isinstance(read, dict)
    assert read["a"] == value
    assert type(read["a"]) is type(value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\nb: 2\na: 3\n", "line 3: a: is there already, in line 1"),
        ("limits:\n  force_max_n: 400\n  force_max_n: 40000\n", "line 3: limits.force_max_n: is there already, in line 2"),
        ("a: {b: 1, b: 2}", "a.b: is there already"),
        ('"a": 1\na: 2', "line 2: a: is there already"),
        ("a: 0300", "line 1: a: 0300 begins with a zero"),
        ("a: -007.5", "begins with a zero"),
        ("a: 3_0", "has an underscore"),
        ("a: 1:30", "base 60"),
        ("a: yes", "write true or false"),
        ("a: Off", "write true or false"),
        ("loads_n:\n- 10\n- no", "line 3: loads_n.1: no may be a truth value"),
        ("a: [30,5]", "30,5 may be one number or several"),
        ("a: [[16, 0],[0,16]]", "a.1: 0,16 may be"),
        ("a: 30,5", "has a comma between digits"),
        ("a: 1,000.5", "has a comma between digits"),
        ("a: .inf", "is not a finite number"),
        ("a: -.INF", "is not a finite number"),
        ("a: .nan", "is not a finite number"),
        ("a: 1e999", "beyond the range"),
        ("a: " + "1" * 5000, "a number of 5000 digits"),
        ("a: 0b11", "is not a number of YAML 1.2"),
        ("a: !!float '3'", "the tag"),
        ("a: !!python/object/apply:os.getcwd []", "the tag"),
        ("a: &a [*a]", "not complete"),
        ("b: &b {x: 1}\na:\n  <<: *b", "line 3: a: << merges keys"),
        ("a:\n\tb: 1", "line 2 is indented with a tab"),
        ("a: 1\n---\na: 2", "line 2: a second document"),
        ("%YAML 1.1\n---\na: 1", "only YAML 1.2 is read"),
        ("? [a]\n: b", "a key must be text or an integer"),
        ("a: [b\nc: }", "line 2 is not YAML"),
        ("a: \x07", "line 1 is not YAML"),
        (b"a: 1\nb: \xff", "line 2: is not UTF-8"),
        ("# " + "x" * MOST_BYTES, "is larger than 1 MB"),
        ("a: " + "[" * 5000 + "]" * 5000, f"nested more than {MOST_NESTED} deep"),
        ("- " * 5000 + "a", f"nested more than {MOST_NESTED} deep"),
        ("a: " + "{b: " * 5000 + "}" * 5000, f"nested more than {MOST_NESTED} deep"),
        (TEN_OF_TEN, "more than 200000 values"),
    ],
)
def test_what_can_be_misread_is_refused(text: str | bytes, words: str) -> None:
    assert words in refusal(text)


def test_every_value_has_its_line() -> None:
    text = read_yaml("a: 1\nb:\n  c: [1, 2]\n  d:\n  - x: 5\n", "run.yaml")
    assert text.line(("a",)) == 1
    assert text.line(("b", "c", 1)) == 3
    assert text.line(("b", "d", 0, "x")) == 5
    assert text.line(("b", "d", 0, "missing")) == 5
    assert text.line(("nothing",)) is None


def test_an_alias_repeats_its_anchor() -> None:
    text = read_yaml("a: &one [1, 2]\nb: *one", "run.yaml")
    assert text.value == {"a": [1, 2], "b": [1, 2]}
    assert text.line(("b", 0)) == 1  # where the value is written


@pytest.mark.checkout
def test_every_yaml_file_that_comes_along_means_what_it_meant() -> None:
    found = [path for folder in ("deploy", "drivers", "simulators") for path in (ROOT / folder).rglob("*.yaml")]
    assert len(found) > 10
    for path in found:
        assert read_yaml(path.read_bytes(), path.name).value == yaml.safe_load(path.read_text(encoding="utf-8"))


@given(st.text(alphabet="ab:-[]{},&*'\"\n\t |>#!%01.?~<_é", max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(BadConfig):
        found = read_yaml(text, "run.yaml")
        assert all(1 <= line <= text.count("\n") + 1 for line in found.lines.values())
