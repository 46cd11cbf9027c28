"""What commands print: text from outside (names of files, replies of devices, headers) cannot steer the terminal or imitate markup."""

from __future__ import annotations

import typer
from rich.markup import escape

from semlive.data.text import printable


def echo(line: str, err: bool = False) -> None:
    """Print one line."""
    typer.echo(printable(line), err=err)


def cell(text: str) -> str:
    """One line for rich, which takes square brackets for markup and passes control characters on."""
    return escape(printable(text))
