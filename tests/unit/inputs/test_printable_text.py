"""Text from outside cannot steer a terminal."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.inputs.printable import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("frame_001.tif", "frame_001.tif"),
        ("Prüfung 5 µm, 日本.tif", "Prüfung 5 µm, 日本.tif"),
        ("a\x1b[2J\x1b[31mall is well", "a\\x1b[2J\\x1b[31mall is well"),
        ("a\nsemlive: stopped\r", "a\\nsemlive: stopped\\r"),
        ("\x9b2J", "\\x9b2J"),
        ("fit\u202e.exe", "fit\\u202e.exe"),
        ("\udcff.tif", "\\udcff.tif"),
        ("\x07\x00\x7f", "\\x07\\x00\\x7f"),
    ],
)
def test_control_characters_are_shown_as_escape_sequences(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_line_breaks_are_retained_on_request() -> None:
    assert printable("one\ntwo\x1b", keep="\n") == "one\ntwo\\x1b"


@given(st.text())
def test_no_hidden_character_remains(text: str) -> None:
    shown = printable(text)
    assert not any(unicodedata.category(item) in ("Cc", "Cf", "Cs", "Zl", "Zp") for item in shown)
    assert printable(shown) == shown
