"""The next step of a qualification is proposed in a terminal, and taken only after a person has set the scan."""

from __future__ import annotations

import os
import pty
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from semlive.cli.before_run.qualifying_run import further_log
from semlive.qualify.values import Conditions, Figure, Protocol, Qualification

FOUND = Qualification(
    1, Conditions("a", 0, 18, 9, 512, 442, 1e-5, 1e-2, 5.0, 100.0, "fei", True),
    (Figure("frame_interval", "frame interval", 1.125, 1.12, 1.13, ""),), (), (), (), "", "",
    Protocol(0.0, None, 1.0, 31, 10, 5, ((0.0, 0.0),), 1.0, 1.0),
)  # fmt: skip
"""A pause between the frames, which fewer rows separate from a wrong row time."""


@contextmanager
def typed(monkeypatch: pytest.MonkeyPatch, text: str) -> Iterator[None]:
    """Standard input is a terminal into which a person types."""
    person, terminal = pty.openpty()
    with os.fdopen(terminal, encoding="utf-8") as stream:
        os.write(person, text.encode())
        monkeypatch.setattr(sys, "stdin", stream)
        yield
    os.close(person)


def test_the_step_and_its_reason_are_shown_and_end_takes_no_pairs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with typed(monkeypatch, "end\n"):
        assert further_log(FOUND, tmp_path) is None
    shown = capsys.readouterr().err
    assert "scan half of the rows" in shown
    assert "press Enter" in shown
    assert list(tmp_path.iterdir()) == []


def test_enter_takes_the_step_and_a_failed_run_does_not_lose_the_qualification(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with typed(monkeypatch, "\n"):
        assert further_log(FOUND, tmp_path / "log") is None  # there is no such log
    assert str(tmp_path / "log") in capsys.readouterr().err.splitlines()[-1]


def test_nothing_is_proposed_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with (tmp_path / "empty").open("w+") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        assert further_log(FOUND, tmp_path) is None
    assert capsys.readouterr().err == ""
