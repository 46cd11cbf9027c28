"""Child processes end with control, whatever killed it and whatever they are engaged in."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from .by_hand import lives

# Starts analysis and page on a log that does not exist, and analysis again from a thread that ends.
PARENT = """
import subprocess, sys, threading, time
from semlive.service.runtime.process import start_child
log, started = sys.argv[1], []
def start(module, *arguments):
    started.append(start_child(module, [*arguments], stdout=subprocess.PIPE))
start("semlive.service.analysis.worker", "--log", log)
start("semlive.web", log, "--host", "127.0.0.1", "--port", "0", "--exit-with-stdin")
thread = threading.Thread(target=start, args=("semlive.service.analysis.worker", "--log", log))
thread.start()
thread.join()
print(*(one.pid for one in started), flush=True)
time.sleep(600)
"""


def test_children_end_within_two_seconds_of_the_parents_death(tmp_path: Path, wait_until: Callable[..., None]) -> None:
    command = [sys.executable, "-c", PARENT, str(tmp_path / "log")]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    children = [int(item) for item in parent.stdout.readline().split()]
    time.sleep(3.0)
    assert [lives(pid) for pid in children] == [True, True, True]
    os.kill(children[0], signal.SIGSTOP)
    parent.kill()
    parent.communicate()
    wait_until(lambda: not any(lives(pid) for pid in children), 2.0)


def test_a_child_whose_parent_died_before_it_began_does_nothing(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "semlive.service.runtime.child_process",
        str(os.getpid() + 1),
        "semlive.service.analysis.worker",
        "--log",
        str(tmp_path),
    ]
    done = subprocess.run(command, check=False, stdin=subprocess.DEVNULL, capture_output=True, timeout=60)
    assert (done.returncode, done.stdout) == (1, b"")
