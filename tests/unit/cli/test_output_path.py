"""Output paths are checked before the work begins, and files are written completely or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.cli.shared.output_path import emptied_if_refused, output_file, output_folder, write_text
from semlive.errors import BadInput, SemliveError

COMMANDS = (
    ("report", "LOG", "--out", "FILE"),
    ("report", "LOG", "--figures", "FOLDER"),
    ("report", "LOG", "--pdf", "FILE"),
    ("diagnose", "LOG", "--html", "FILE"),
    ("diagnose", "LOG", "--out", "FILE"),
    ("diagnose", "LOG", "--pdf", "FILE"),
    ("diagnose", "LOG", "--figures", "FOLDER"),
    ("experiment", "propose", "LOG", "--out", "FILE"),
    ("export", "LOG", "--format", "hdf5", "--out", "FILE"),
    ("export", "LOG", "--format", "png", "--out", "FOLDER"),
    ("reanalyse", "LOG", "--out", "FOLDER"),
    ("recover", "LOG", "--out", "FILE"),
    ("import", "LOG", "--out", "FILE"),
    ("simulate", "short", "--out", "FOLDER"),
    ("demo", "--out", "FOLDER"),
    ("init", "FILE", "--yes"),
    ("score", "LOG", "--truth", "LOG", "--figures", "FOLDER"),
    ("qualify", "--from", "LOG", "--out", "FILE"),
    ("qualify", "--from", "LOG", "--report", "FILE"),
    ("qualify", "--from", "LOG", "--pdf", "FILE"),
    ("qualify", "--from", "LOG", "--protocol", "FILE"),
)

REPLACED_FILES = [
    command for command in COMMANDS if "FILE" in command and command[0] in ("export", "import", "diagnose") and "--out" in command
]
"""Commands that write a file under another name and rename it."""


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_path_below_a_file_is_refused_before_the_log_is_read(tmp_path: Path, command: tuple[str, ...]) -> None:
    (tmp_path / "note.txt").write_text("a file", encoding="utf-8")
    path = str(tmp_path / "note.txt" / "below")
    words = [path if word in ("FILE", "FOLDER") else str(tmp_path / "none.mcap") if word == "LOG" else word for word in command]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, BadInput)
    assert "note.txt is a file" in str(done.exception)
    assert sorted(tmp_path.iterdir()) == [tmp_path / "note.txt"]


@pytest.mark.parametrize("command", [command for command in COMMANDS if "FILE" in command and command[0] != "recover"], ids=" ".join)
def test_a_folder_in_place_of_a_file_is_refused(tmp_path: Path, command: tuple[str, ...]) -> None:
    words = [str(tmp_path) if word == "FILE" else str(tmp_path / "none.mcap") if word == "LOG" else word for word in command]
    done = CliRunner().invoke(app, [*words, "--force"] if command[0] == "init" else words)
    assert isinstance(done.exception, BadInput)
    assert "give the name of a file" in str(done.exception)


@pytest.mark.parametrize("command", REPLACED_FILES, ids=" ".join)
def test_a_device_is_not_replaced_by_a_file(tmp_path: Path, command: tuple[str, ...]) -> None:
    os.mkfifo(tmp_path / "device")
    words = [str(tmp_path / ("device" if word == "FILE" else "none.mcap")) if word in ("FILE", "LOG") else word for word in command]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, BadInput)
    assert "is a device; give the name of a file" in str(done.exception)


def test_the_folder_of_a_file_is_made_and_that_of_a_folder_is_not(tmp_path: Path) -> None:
    assert output_file(tmp_path / "new" / "page.html", "--out").parent.is_dir()
    assert not output_folder(tmp_path / "other" / "figures", "--out").parent.exists()


def test_folders_of_the_kernel_are_refused() -> None:
    with pytest.raises(BadInput, match="no file can be made in /proc"):
        output_file(Path("/proc/page.html"), "--out")


def test_a_file_is_replaced_completely(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    write_text(page, "first")
    write_text(page, "second, \u00b5m")
    assert page.read_text(encoding="utf-8") == "second, \u00b5m"
    assert list(tmp_path.iterdir()) == [page]


def test_a_page_that_cannot_be_written_keeps_the_former_one(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    write_text(page, "first")
    (tmp_path / "page.html.part").mkdir()
    with pytest.raises(SemliveError, match="cannot be written"):
        write_text(page, "second")
    assert page.read_text(encoding="utf-8") == "first"


def test_a_device_is_written_directly() -> None:
    write_text(Path(os.devnull), "gone")


def test_a_folder_is_as_before_after_bad_input(tmp_path: Path) -> None:
    def refuse(folder: Path) -> None:
        with emptied_if_refused(folder):
            (folder / "without" / "instrument").mkdir(parents=True)
            (folder / "model.json").write_text("{}")
            raise BadInput("no such scenario")

    empty, new = tmp_path / "empty", tmp_path / "a" / "new"
    empty.mkdir()
    for folder in (empty, new, new):
        with pytest.raises(BadInput, match="no such scenario"):
            refuse(folder)
    assert [path.name for path in tmp_path.rglob("*")] == ["empty"]
