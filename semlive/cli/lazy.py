"""Commands that are imported when they are called, so that help texts do not import the numerical packages."""

from __future__ import annotations

import contextlib
import gc
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from semlive.service.runtime.garbage import enable_garbage_collection


@dataclass(frozen=True, slots=True)
class CommandEntry:
    """Entry of the list of commands.

    Attributes:
        name: name that the user types.
        import_path: ``module:attribute`` of the function, or of a Typer with sub-commands.
        short: first line of the help.
        panel: heading of the group in the list.
    """

    name: str
    import_path: str
    short: str
    panel: str


def group_of(entries: tuple[CommandEntry, ...]) -> type[TyperGroup]:
    """A group that imports a command only when the command is called.

    Listing the commands for help, completion or spelling suggestions imports none; importing all took 2.3 s of processor time.
    """
    by_name = {entry.name: entry for entry in entries}

    class LazyGroup(TyperGroup):
        """Imports the command that a name refers to."""

        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            for entry in entries:
                self.add_command(TyperCommand(entry.name, help=entry.short, rich_help_panel=entry.panel))

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            """Name, imported command, and remaining arguments."""
            name, command, remaining = super().resolve_command(ctx, args)
            return name, command if name is None else load(by_name[name]), remaining

    return LazyGroup


def load(entry: CommandEntry) -> Any:
    """Import a command and return it."""
    module, attribute = entry.import_path.split(":")
    with deferred_keyboard_interrupt():
        target = getattr(import_module(module), attribute)
    if not gc.isenabled():
        enable_garbage_collection()
    if isinstance(target, typer.Typer):
        command: Any = typer.main.get_group(target)
    else:
        single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        single.command(entry.name)(target)
        command = typer.main.get_command(single)
    command.name = entry.name
    return command


@contextlib.contextmanager
def deferred_keyboard_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end of the context instead of within it.

    Importing takes a second, and an extension module that is interrupted during its initialisation raises ImportError.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread receives signals
        return
    interrupts: list[int] = []
    previous_handler = signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
    if interrupts:
        raise KeyboardInterrupt
