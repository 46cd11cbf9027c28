"""The command line's front door: Ctrl-C is taken care of before anything is imported."""

from __future__ import annotations

import os
import sys

from semlive.service.runtime.jit_cache import configure_jit_cache

_ENDED_BY_CTRL_C = 130
_STOPPED = 1


def main() -> None:
    """Run a command; errors are one line on standard error (exit code 2 for bad input, 1 for a failure on the way)."""
    configure_jit_cache(os.environ)
    try:
        from semlive.cli.app import run_app  # noqa: PLC0415

        code = run_app()
    except KeyboardInterrupt:
        code = _ENDED_BY_CTRL_C
    if code == _ENDED_BY_CTRL_C:
        sys.stderr.write("stopped by the operator\n")
        code = _STOPPED
    sys.exit(code)
