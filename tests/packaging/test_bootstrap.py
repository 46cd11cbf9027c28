"""go.py: when it sets up, when it does not, and its message when it cannot."""

from __future__ import annotations

import importlib.util
import json
import sys
import types
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.checkout


@pytest.fixture
def go() -> types.ModuleType:
    """go.py as a module."""
    spec = importlib.util.spec_from_file_location("go", ROOT / "go.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def project(go: types.ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A project whose environments are one empty file and whose pip only records its arguments."""
    (tmp_path / "pyproject.toml").write_text("[project]\n", "utf-8")
    (tmp_path / "installed.txt").write_text("", "utf-8")

    def install(arguments: list[str], log: Path) -> int:
        log.write_text("ERROR: No matching distribution found for sand.\n", "utf-8")
        with (tmp_path / "installed.txt").open("a", encoding="utf-8") as notes:
            notes.write(Path(arguments[-1]).name + "\n")
        return 1 if "sand" in (tmp_path / "pyproject.toml").read_text("utf-8") else 0

    def make(venv: Path) -> None:
        python = go.python_of(venv)
        python.parent.mkdir(parents=True, exist_ok=True)
        python.touch()

    monkeypatch.setenv("PATH", str(tmp_path))  # without uv
    monkeypatch.setattr(go, "ROOT", tmp_path)
    monkeypatch.setattr(go, "run_logged", install)
    monkeypatch.setattr(go, "make_environment", make)
    return tmp_path


def installs(project: Path) -> list[str]:
    return [("test" if line.endswith("[test]") else "run") for line in (project / "installed.txt").read_text("utf-8").splitlines()]


def test_it_sets_up_once_and_again_when_the_project_changes(go: types.ModuleType, project: Path) -> None:
    venv = project / "venv"
    go.set_up(venv, "run")
    go.set_up(venv, "run")
    assert installs(project) == ["run"]
    (project / "pyproject.toml").write_text("[project]\nname = 'x'\n", "utf-8")
    go.set_up(venv, "run")
    assert installs(project) == ["run", "run"]


def test_what_serves_the_tests_serves_the_demo_too(go: types.ModuleType, project: Path) -> None:
    venv = project / "venv"
    for kind in ("run", "test", "run", "test"):
        go.set_up(venv, kind)
    assert installs(project) == ["run", "test"]


def test_an_environment_keeps_what_was_installed_before(go: types.ModuleType, project: Path) -> None:
    venv = project / "venv"
    for kind in ("test", "docs", "run", "test", "docs"):
        go.set_up(venv, kind)
    names = (project / "installed.txt").read_text("utf-8").splitlines()
    assert [name.partition("[")[2] for name in names] == ["test]", "docs,test]"]


@pytest.mark.parametrize(("command", "kind"), [("test", "test"), ("lint", "test"), ("docs", "docs"), ("demo", "run")])
def test_a_command_gets_the_environment_that_it_needs(
    go: types.ModuleType, command: str, kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(venv: Path, needed: str) -> None:
        raise go.Refused(f"needs {needed}.")

    monkeypatch.setattr(go, "set_up", refuse)
    assert go.main([command]) == 2
    assert capsys.readouterr().err == f"go.py: needs {kind}.\n"


def test_docs_takes_one_folder(go: types.ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert go.build_docs(tmp_path, ["here", "there"]) == 2
    assert go.build_docs(tmp_path, ["--quick"]) == 2
    assert "go.py docs [FOLDER]" in capsys.readouterr().err


def test_another_python_or_another_place_means_another_environment(
    go: types.ModuleType, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    venv = project / "venv"
    go.set_up(venv, "run")
    monkeypatch.setattr(go, "version", lambda: "3.99")
    go.set_up(venv, "run")
    assert installs(project) == ["run", "run"]
    assert json.loads((venv / "semlive-setup.json").read_text("utf-8"))["python"] == "3.99"


def test_a_failed_installation_gives_one_error_line_and_is_tried_again(go: types.ModuleType, project: Path) -> None:
    (project / "pyproject.toml").write_text("sand", "utf-8")
    venv = project / "venv"
    for _ in range(2):
        with pytest.raises(go.Refused, match=r"No matching distribution found for sand.*see .*semlive-setup\.log"):
            go.set_up(venv, "run")
    assert installs(project) == ["run", "run"]


@pytest.mark.parametrize(("code", "installers"), [(0, ["uv"]), (2, ["uv", "pip"])])
def test_uv_is_used_where_it_is_on_path_and_pip_where_it_fails(
    go: types.ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, code: int, installers: list[str]
) -> None:
    """Both programs only record that they were called."""
    called = tmp_path / "called.txt"
    python = go.python_of(tmp_path / "venv")
    python.parent.mkdir(parents=True)
    for program, name, result in ((tmp_path / "uv", "uv", code), (python, "pip", 0)):
        program.write_text(f"#!/bin/sh\necho {name} >> {called}\nexit {result}\n", "utf-8")
        program.chmod(0o755)
    (tmp_path / "pyproject.toml").write_text("[project]\n", "utf-8")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(go, "ROOT", tmp_path)
    monkeypatch.setattr(go, "make_environment", lambda venv: None)
    go.set_up(tmp_path / "venv", "run")
    assert called.read_text("utf-8").split() == installers


def test_a_folder_that_is_no_environment_is_not_changed(go: types.ModuleType, tmp_path: Path) -> None:
    precious = tmp_path / "thesis"
    precious.mkdir()
    (precious / "chapter1.txt").write_text("years of work", "utf-8")
    with pytest.raises(go.Refused, match="no virtual environment: name another folder in SEMLIVE_VENV"):
        go.make_environment(precious)
    assert (precious / "chapter1.txt").read_text("utf-8") == "years of work"


def test_an_old_python_reports_so(go: types.ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(go, "OLDEST", (99, 1))
    with pytest.raises(go.Refused, match=r"needs Python 99\.1 or newer"):
        go.require_python()


def test_a_python_without_venv_reports_so(go: types.ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(go.Refused, match="lacks Python's venv module: install it"):
        go.require_python()


def test_without_a_command_it_explains_itself(go: types.ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    assert go.main([]) == 2
    assert "python3 go.py demo" in capsys.readouterr().out


@pytest.mark.parametrize("code", [0, 2])
def test_waiting_returns_the_exit_code(go: types.ModuleType, code: int) -> None:
    assert go.become([sys.executable, "-c", f"raise SystemExit({code})"], ".", replace=False) == code
