"""The script for Windows: PowerShell would take it, and the commands that it calls exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import tree_sitter_powershell
from tree_sitter import Language, Node, Parser

from semlive.cli.app import COMMANDS
from semlive.cli.lazy import load

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "deploy" / "semlive-task.ps1"
PARAMETERS = {
    "Get-Date": "",
    "Get-ScheduledTask": "TaskName",
    "Join-Path": "",
    "New-Item": "ItemType Force Path",
    "New-ScheduledTaskAction": "Execute Argument WorkingDirectory",
    "New-ScheduledTaskPrincipal": "UserId LogonType RunLevel",
    "New-ScheduledTaskSettingsSet": "ExecutionTimeLimit MultipleInstances AllowStartIfOnBatteries DontStopIfGoingOnBatteries Priority",
    "Out-Null": "",
    "Register-ScheduledTask": "TaskName Action Settings Principal Force",
    "Resolve-Path": "LiteralPath",
    "Set-StrictMode": "Version",
    "Split-Path": "Parent",
    "Start-ScheduledTask": "TaskName",
    "Start-Sleep": "Seconds",
    "Stop-ScheduledTask": "TaskName",
    "Test-Path": "LiteralPath",
    "Unregister-ScheduledTask": "TaskName Confirm",
}
"""Commands of PowerShell 5.1 and their parameters that the script may use (reference of Microsoft.PowerShell and ScheduledTasks)."""

pytestmark = pytest.mark.checkout


def nodes(node: Node) -> Iterator[Node]:
    yield node
    for child in node.children:
        yield from nodes(child)


def described() -> str:
    """The lines of the manual about Windows."""
    return (ROOT / "docs" / "how-to" / "deploy.md").read_text(encoding="utf-8").split("\n## Windows\n")[1].split("\n## ")[0]


def test_the_script_parses_and_calls_what_there_is() -> None:
    source = SCRIPT.read_bytes()
    tree = Parser(Language(tree_sitter_powershell.language())).parse(source)
    wrong = [(item.start_point.row + 1, item.text) for item in nodes(tree.root_node) if item.type == "ERROR" or item.is_missing]
    assert not wrong
    called = {item.text.decode() for item in nodes(tree.root_node) if item.type == "command_name" and item.text}
    assert {"Register-ScheduledTask", "Start-ScheduledTask", "Stop-ScheduledTask", "Unregister-ScheduledTask"} <= called
    text = source.decode()
    named = set(re.findall(r"(?:& \$Semlive|[:;] semlive|-Argument \"|^semlive) (?!-)(\w+)|-Argument \"(\w+)", text))
    assert {item for pair in named for item in pair if item} <= {entry.name for entry in COMMANDS}
    requests = set(re.findall(r"(?<=\[switch\]\$)\w+", text))
    assert requests == set(re.findall(r"if \(\$(\w+)\)", text)), "every switch has its branch"


def test_commands_of_powershell_have_the_parameters_that_the_script_uses() -> None:
    tree = Parser(Language(tree_sitter_powershell.language())).parse(SCRIPT.read_bytes())
    for command in (item for item in nodes(tree.root_node) if item.type == "command"):
        name = next((item.text.decode() for item in command.children if item.type == "command_name" and item.text), "")
        if not name:
            continue  # & $Semlive
        elements = [item for child in command.children if child.type == "command_elements" for item in child.children]
        used = {item.text.decode().strip("-:") for item in elements if item.type == "command_parameter" and item.text}
        assert used <= set(PARAMETERS[name].split()), name


def test_the_manual_and_the_help_of_the_script_use_parameters_and_paths_that_exist() -> None:
    script = SCRIPT.read_text(encoding="utf-8")
    parameters = set(re.findall(r"\[\w+\]\$(\w+)", script.split("param(")[1].split("\n)\n")[0]))
    help_text = script.split("#>")[0]
    shown = re.findall(r"(?<=[\s`])-([A-Z]\w+)", described().replace("-ExecutionPolicy Bypass -File", "")) + re.findall(
        r" -([A-Z]\w+)", help_text
    )
    assert len(shown) > 8
    assert set(shown) <= parameters
    (default,) = re.findall(r'\$env:ProgramData "([^"]+)\\Scripts\\semlive\.exe"', script)
    environments = set(re.findall(r"C:\\ProgramData\\[\w\\]*venv", described() + script))
    assert environments == {f"C:\\ProgramData\\{default}"}


def test_options_of_semlive_in_the_script_exist() -> None:
    script = SCRIPT.read_text(encoding="utf-8")
    commands = {entry.name: entry for entry in COMMANDS}
    lines = re.findall(r"(?:semlive|& \$Semlive|-Argument \"|semlive run CONFIG) ?(run|doctor|init)\b([^;{}\n]*)", script)
    assert {name for name, _ in lines} == {"run", "doctor", "init"}
    for name, rest in lines:
        existing = {option for item in load(commands[name]).params for option in item.opts}
        assert set(re.findall(r"--[a-z-]+", rest)) <= existing, rest
