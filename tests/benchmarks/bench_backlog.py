"""Memory of control while analysis is stopped and everything waits for it.

    python tests/benchmarks/bench_backlog.py [--pairs 2000] [--frames 16]

Recorder, journal and the link to the analysis process as the daemon has them, without engine and devices. The analysis process is stopped
(SIGSTOP) before the first message, and for every pair `--frames` files of 51 kB, as many readings as a pair of two minutes has at 2 Hz and
the messages of a pair are recorded. Prints one JSON object: memory (resident set without pages of files; /proc, Linux), its slope after the
first quarter from the means of 16 stretches, with the standard error that their scatter gives. The exit code is 1 if the slope is beyond
three of its errors and more than 1 MB in 1000 pairs.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from bench_soak import processes, slope

from semlive.data.frame import ExportedFile
from semlive.formats.log.messages import LogLineMessage, StateMessage
from semlive.service.analysis import process
from semlive.service.analysis.process import AnalysisProcess
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.log.run_log import RunLog
from semlive.service.runtime.clock import SystemClock

FILE_BYTES = 51_000
READINGS = 240
STATES = 8


def children() -> set[int]:
    """Processes that this one started."""
    return {int(item) for path in Path("/proc/self/task").iterdir() for item in (path / "children").read_text().split()}


def measure(pairs: int, frames: int, folder: Path) -> dict[str, object]:
    """Record so many pairs while nobody reads."""
    process._MAX_SILENT_AT_START_S = 1e9  # else another would be started in its place
    clock, before = SystemClock(), children()
    recorder = Recorder(segment_path(folder, "run", 0), clock, sys.exit)
    link = AnalysisProcess(folder, lambda: recorder.write_failed, lambda _: None, lambda what, _: sys.exit(what))
    (child,) = children() - before
    os.kill(child, signal.SIGSTOP)
    journal = RunLog(recorder)
    journal.subscribe(link.notify_input)
    taken, export = list[tuple[float, float]](), 0
    for _ in range(pairs):
        now_ns = clock.now_ns()
        for _ in range(frames):
            data = os.urandom(FILE_BYTES)
            journal.file(ExportedFile(export, f"{export}.tif", data, f"{export:064x}", now_ns, now_ns))
            export += 1
        for number in range(READINGS):
            journal.write_message(LogLineMessage(time_ns=now_ns, level="info", text=f"reading {number}"))
        for _ in range(STATES):
            journal.write_message(StateMessage(time_ns=now_ns, before="holding", after="imaging", cause="hold_over", step=0, guards={}))
        recorder.flush(60.0)
        taken.append((float(len(taken)), processes(os.getpid())["control"]))
    logged_mb = sum(path.stat().st_size for path in folder.iterdir()) / 1e6
    link.kill()
    link.close(0.0)
    recorder.close()
    there = np.array(taken)
    return {"pairs": pairs, "logged_mb": round(logged_mb), "control": slope(there[:, 0], there[:, 1], 1.0)}


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=2000)
    parser.add_argument("--frames", type=int, default=16)
    options = parser.parse_args()
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        reported = measure(options.pairs, options.frames, Path(folder))
    sys.stdout.write(json.dumps(reported | {"wall_s": round(time.monotonic() - began_s)}) + "\n")
    control = reported["control"]
    assert isinstance(control, dict)
    return int(control["mb_per_1000_pairs"] > max(1.0, 3.0 * control["standard_error"]))


if __name__ == "__main__":
    sys.exit(main())
