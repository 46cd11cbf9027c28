"""Starts a module as the main program of a child process that ends with its parent, even if the parent is killed.

``python -m semlive.service.runtime.child_process PARENT_PID MODULE [ARGUMENT...]``. Only light modules are imported
here, because the parent may be killed while the child still imports numerical packages.
"""

from __future__ import annotations

import ctypes
import gc
import os
import runpy
import signal
import sys
import threading
import time

_PR_SET_PDEATHSIG = 1
_POLL_S = 0.5


def main() -> None:
    """Bind this process to its parent, then run the module, which enables garbage collection when its imports are done."""
    parent, module = int(sys.argv[1]), sys.argv[2]
    end_with_parent(parent)
    gc.disable()
    sys.argv = [module, *sys.argv[3:]]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def end_with_parent(parent: int) -> None:
    """End this process within a second of the end of its parent.

    Linux kills it, even if it is suspended. On other systems a thread polls the parent, which fails in a suspended process. On Windows
    nothing is done; the process ends at the end of its standard input.

    Args:
        parent: process number of the parent, whose starting thread must live as long as the parent itself.
    """
    if sys.platform == "win32":
        return
    bound = sys.platform == "linux" and ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) == 0
    if os.getppid() != parent:  # it died before this process was bound to it
        os._exit(1)
    if not bound:
        threading.Thread(target=_watch_parent, args=(parent,), name="parent", daemon=True).start()


def _watch_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_POLL_S)
    os._exit(1)


if __name__ == "__main__":
    main()
