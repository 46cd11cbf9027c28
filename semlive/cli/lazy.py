"""Commands that are imported when they are called: a help text costs no numerics."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup


@dataclass(frozen=True, slots=True)
class CommandEntry:
    """A command as the list of commands knows it.

    Attributes:
        name: what is typed.
        import_path: ``module:attribute`` of the function, or of the Typer that has commands of its own.
        short: first line of its help.
        panel: heading that it stands under.
    """

    name: str
    import_path: str
    short: str
    panel: str


def group_of(entries: tuple[CommandEntry, ...]) -> type[TyperGroup]:
    """A group whose commands are names until one of them is called.

    Listing them, for help, for completion or to suggest the right spelling, imports none; every import took 2.3 s of processor time.
    """
    known = {one.name: one for one in entries}

    class LazyGroup(TyperGroup):
        """Resolves a name by importing its command."""

        def __init__(self, **given: Any) -> None:
            super().__init__(**given)
            for one in entries:
                self.add_command(TyperCommand(one.name, help=one.short, rich_help_panel=one.panel))

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            """The name, the command itself, and what is left of the arguments."""
            name, named, rest = super().resolve_command(ctx, args)
            return name, named if name is None else load(known[name]), rest

    return LazyGroup


def load(entry: CommandEntry) -> Any:
    """The command itself, imported now."""
    module, attribute = entry.import_path.split(":")
    with deferred_keyboard_interrupt():
        found = getattr(import_module(module), attribute)
    if isinstance(found, typer.Typer):
        command: Any = typer.main.get_group(found)
    else:
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(entry.name)(found)
        command = typer.main.get_command(alone)
    command.name = entry.name
    return command


@contextlib.contextmanager
def deferred_keyboard_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end instead of in the middle.

    Importing takes a second, and an extension module that is interrupted in its initialisation says ImportError.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's alone
        return
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if asked:
        raise KeyboardInterrupt
