"""The command line's front door: nothing heavy is imported before Ctrl-C is taken care of."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator

_ENDED_BY_CTRL_C = 130
_STOPPED = 1


def main() -> None:
    """Run a command; errors are one line on standard error (exit code 2 for bad input, 1 for a failure on the way)."""
    try:
        with _ctrl_c_held_back():
            from semlive.cli.app import run_app  # noqa: PLC0415

        code = run_app()
    except KeyboardInterrupt:
        code = _ENDED_BY_CTRL_C
    if code == _ENDED_BY_CTRL_C:
        sys.stderr.write("stopped by the operator\n")
        code = _STOPPED
    sys.exit(code)


@contextlib.contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end instead of in the middle.

    Importing takes a second, and an extension module that is interrupted in its initialisation says ImportError.
    """
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if asked:
        raise KeyboardInterrupt
