"""The script for Windows: PowerShell would take it, and the commands that it calls exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import tree_sitter_powershell
from tree_sitter import Language, Node, Parser

from semlive.cli.app import COMMANDS

SCRIPT = Path(__file__).resolve().parents[2] / "deploy" / "semlive-task.ps1"

pytestmark = pytest.mark.checkout


def nodes(node: Node) -> Iterator[Node]:
    yield node
    for child in node.children:
        yield from nodes(child)


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
