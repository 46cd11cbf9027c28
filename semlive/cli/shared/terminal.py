"""Safe terminal output: text from outside (file names, device replies, headers) cannot contain control sequences or markup."""

from __future__ import annotations

import typer
from rich.markup import escape

from semlive.inputs.printable import printable


def echo(line: str, err: bool = False) -> None:
    """Print one line."""
    typer.echo(printable(line), err=err)


def cell(text: str) -> str:
    """Escape a line for rich, which reads square brackets as markup and prints control characters."""
    return escape(printable(text))
