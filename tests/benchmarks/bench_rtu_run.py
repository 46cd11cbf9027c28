"""Complete experiments over Modbus RTU: load frame and stage as two units on one serial line, next to busy programs.

    python tests/benchmarks/bench_rtu_run.py [--runs 3] [--busy 2] [--rate 20] [--line rtu|tcp]

The simulated bench answers at the pace of 19,200 baud over a pseudo-terminal. Each run is the real daemon from begin to end: three
translations and two loads, five pairs, 320 x 246 px. `--busy` starts so many programs that do nothing but take processor time.
Prints one JSON object a run: exit code, wall time, pairs, and how long readings took (median, 99 %, worst) and how many came late;
the exit code is 1 if a run did not complete.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.service.log.files import messages

SCENARIO = """
extends: paper_x200
scan: {width_px: 320, height_px: 276, frame_time_s: 9.4}
export: {databar_rows: 30}
detector: {read_noise: 3.0, shot_noise: 0.25}
experiment:
  protocol:
    calibration_shifts_px: [[0, 0], [6, 0], [0, 6]]
    translation_shifts_px: []
    loads_n: [100, 600]
"""


def one_run(folder: Path, bench: dict[str, Any], rate: float, name: str) -> dict[str, Any]:
    """A run from begin to end, and the figures of the line in its log."""
    config = daemon_config(bench, rate)
    config["run"]["name"] = name
    config["dic"] = {"subset_px": 31, "step_px": 8, "roi_px": None}
    config["estimate"] = {"accept_poor_calibration": True}
    config["protocol"]["load_tolerance_n"] = 20.0
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    began_s = time.monotonic()
    command = [sys.executable, "-m", "semlive", "run", str(path), "--stop-on-fault"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    counted, waits_ms, faults = 0, [], []
    for item in messages(folder / "log" / name):
        if item.topic == "/pair":
            counted += 1
        elif item.topic == "/load_frame/sample":
            waits_ms.append(1e3 * (json.loads(item.payload)["rtt_s"] or 0.0))
        elif item.topic == "/fault":
            faults.append(json.loads(item.payload)["what"])
    return {
        "exit_code": done.returncode,
        "wall_s": round(time.monotonic() - began_s, 1),
        "pairs": counted,
        "readings": len(waits_ms),
        "reading_ms": [round(float(value), 1) for value in np.percentile(waits_ms or [0.0], [50, 99, 100])],
        "faults": faults,
        "said": "" if done.returncode == 0 else " ".join(done.stderr.split())[-300:],
    }


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--busy", type=int, default=2, help="programs that take processor time meanwhile")
    parser.add_argument("--rate", type=float, default=20.0, help="experiment seconds per wall second")
    parser.add_argument("--line", choices=("rtu", "tcp"), default="rtu")
    options = parser.parse_args()
    failed = 0
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.busy)]
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "small.yaml").write_text(SCENARIO, encoding="utf-8")
            with running_simulator(str(folder / "small.yaml"), folder / "bench", options.rate, rtu=options.line == "rtu") as bench:
                for number in range(options.runs):
                    found = one_run(folder, bench, options.rate, f"run{number}")
                    failed += found["exit_code"] != 0
                    sys.stdout.write(json.dumps({"line": options.line, "busy": options.busy, **found}) + "\n")
                    sys.stdout.flush()
    finally:
        for item in busy:
            item.kill()
            item.wait()
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
