"""Entry point of the command line; it handles Ctrl-C before the commands are imported."""

from __future__ import annotations

import gc
import os
import sys

_ENDED_BY_CTRL_C = 130
_STOPPED = 1


def main() -> None:
    """Run a command; an error is one line on standard error (exit code 2 for bad input, 1 for a failure during the command)."""
    gc.disable()  # until the command is imported
    try:
        from semlive.service.runtime.jit_cache import configure_jit_cache  # noqa: PLC0415

        configure_jit_cache(os.environ)
        # Every analysis limits linear algebra to one thread. OpenBLAS starts one for each processor when it is loaded, here and in
        # child processes: 0.3 of the 1.9 s of processor time in which the analysis of a run starts on two processors.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from semlive.cli.app import run_app  # noqa: PLC0415

        code = run_app()
    except KeyboardInterrupt:
        code = _ENDED_BY_CTRL_C
    if code == _ENDED_BY_CTRL_C:
        sys.stderr.write("stopped by the operator\n")
        code = _STOPPED
    sys.exit(code)
