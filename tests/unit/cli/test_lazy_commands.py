"""Commands are names until they are called; the names are those of the commands."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys

import pytest
from typer.core import TyperCommand
from typer.testing import CliRunner

from semlive.cli.app import COMMANDS, app
from semlive.cli.lazy import CommandEntry, load

HEAVY = {"numpy", "scipy", "numba", "cv2", "matplotlib", "pydantic", "asyncio", "h5py", "mcap"}


@pytest.fixture(scope="module")
def loaded() -> dict[str, TyperCommand]:
    return {entry.name: load(entry) for entry in COMMANDS}


@pytest.mark.parametrize("entry", COMMANDS, ids=lambda entry: entry.name)
def test_the_list_reports_what_the_command_reports(entry: CommandEntry, loaded: dict[str, TyperCommand]) -> None:
    printed = inspect.cleandoc(loaded[entry.name].help or "").split("\n\n")[0].replace("\n", " ").strip()
    assert entry.short == printed
    assert loaded[entry.name].name == entry.name


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
def test_nothing_heavy_is_imported_to_list_commands(arguments: list[str]) -> None:
    code = f"import sys, semlive.cli.main as front\nsys.argv = ['semlive', *{arguments}]\ntry: front.main()\nexcept SystemExit: pass\n"
    code += f"sys.stderr.write('imported:' + ','.join(sorted({sorted(HEAVY)} & sys.modules.keys())))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr.endswith("imported:"), done.stderr


def test_a_run_imports_no_numerical_packages_into_its_own_process() -> None:
    """The analysis has a process of its own; control started twice as fast, in less than half the memory, without them."""
    modules = ("during_run.run", "during_run.serve", "before_run.demo", "without_run.simulate")
    code = f"import sys, {', '.join(f'semlive.cli.{module}' for module in modules)}\n"
    code += "sys.stdout.write(','.join(sorted({'scipy', 'numba', 'matplotlib', 'semlive.dic'} & sys.modules.keys())))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == ""


def test_help_names_every_command_and_a_typo_is_put_right() -> None:
    printed = CliRunner().invoke(app, ["--help"]).output
    assert not [entry.name for entry in COMMANDS if f" {entry.name} " not in printed]
    wrong = CliRunner().invoke(app, ["reprot"])
    assert wrong.exit_code == 2
    assert "'report'" in wrong.output


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_given_as_a_script(shell: str) -> None:
    environ = {**os.environ, "_SEMLIVE_COMPLETE": f"source_{shell}"}
    command = [sys.executable, "-c", "import sys; sys.argv[0] = 'semlive'; from semlive.cli.main import main; main()"]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert f"_SEMLIVE_COMPLETE=complete_{shell}" in done.stdout


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("semlive re", {"recover", "replay", "report", "reanalyse"}), ("semlive init --lo", {"--load-steps", "--loading-axis"})],
)
def test_tab_offers_names_and_options(typed: str, offered: set[str]) -> None:
    environ = {**os.environ, "_SEMLIVE_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    command = [sys.executable, "-c", "import sys; sys.argv[0] = 'semlive'; from semlive.cli.main import main; main()"]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=60, check=False)
    assert set(done.stdout.split()) == offered
