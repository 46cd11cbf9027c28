"""The command line's front door: nothing heavy is imported before Ctrl-C is taken care of."""

from __future__ import annotations

import sys


def main() -> None:
    """Run a command; errors are one line on standard error (exit code 2 for bad input, 1 for a failure on the way)."""
    try:
        # Importing takes a second, and Ctrl-C may come in it.
        from semlive.cli.app import run_app  # noqa: PLC0415

        code = run_app()
    except KeyboardInterrupt:
        sys.stderr.write("stopped by the operator\n")
        code = 1
    sys.exit(code)
