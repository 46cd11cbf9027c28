"""Files dropped into export folders in every pattern of arrival, each accepted or refused once; and how soon a complete file is accepted.

    python tests/benchmarks/bench_watch.py --files 10000 --seed 1
    python tests/benchmarks/bench_watch.py --latency 200 --write

The campaign: real files in real folders under a clock that is moved by hand: one folder of FEI, Zeiss, TESCAN and plain files, one of
JEOL and one of Hitachi files with their texts next to them, each with files from before the run. A pattern is a generator that does to its
file what a microscope, a share or a hand does, a step a second, and gives what the watch must make of it. One JSON line is printed; the
code is 1 if any verdict is wrong, missing or given twice.

With ``--latency`` so many files of each format are written in real time; watches with and without file-system events look at one folder.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from arrivals.latency import FORMATS, latencies, latency_table
from arrivals.patterns import SCENES
from arrivals.scene import GIVE_UP_S, SIDECAR_S, HandClock, Scene, Steps, wrong_verdicts
from paper import write_between

from semlive_simulators.exporters.settings import Vendor

ROBUSTNESS = Path(__file__).parents[2] / "docs" / "validation" / "robustness.md"


def play(scene: Scene, patterns: tuple[Callable[[Scene], Steps], ...], files: int, at_once: int) -> float:
    """Drop so many files, some each second, while the share goes away now and then; gives the processor time of the watch, s."""
    running: list[Steps] = []
    spent_s, second, end_second = 0.0, 0, 0
    while len(scene.expected) < files or running or second < end_second:
        if len(scene.expected) < files:
            end_second = second + SIDECAR_S + 2 * GIVE_UP_S
            running += [patterns[int(scene.rng.integers(len(patterns)))](scene) for _ in range(at_once)]
        running = [one for one in running if next(one, running) is None]
        away = second % 97 == 50
        if away:
            scene.path.rename(scene.aside)
        started = time.process_time()
        scene.folder.poll()
        spent_s += time.process_time() - started
        if away:
            scene.aside.rename(scene.path)
        scene.clock.ns += 10**9
        second += 1
    return spent_s


def measure(files: int, seed: int, folder: Path, at_once: int = 15) -> dict[str, object]:
    """The complete campaign: so many files over all scenes, and as many from before the run in the first."""
    figures: dict[str, object] = {"files": 0, "seed": seed}
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    spent_s, taken, refused = 0.0, 0, 0
    for number, (vendor, vendors, patterns) in enumerate(SCENES):
        path = folder / f"export{number}"
        path.mkdir()
        scene = Scene(path, folder / f"away{number}", HandClock(), vendors, np.random.default_rng((seed, number)), vendor)
        for old in range(files // 10):
            (path / f"old_{old}.tif").write_bytes(b"from before")
        scene.open()
        spent_s += play(scene, patterns, files // 2 if number == 0 else files // 4, at_once)
        wrong += wrong_verdicts(scene)
        counts.update(one.pattern for one in scene.expected.values())
        taken, refused = taken + len(scene.files), refused + len(scene.refused)
    figures |= {"files": counts.total(), "taken": taken, "refused": refused, "wrong": len(wrong), "first_wrong": wrong[:5]}
    return figures | {"by_pattern": dict(sorted(counts.items())), "processor_ms_per_file": round(1e3 * spent_s / counts.total(), 2)}


def main() -> int:
    """Run the campaign or the measurement that the arguments request."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--latency", type=int, metavar="FILES", help="measure the latency with so many files of each format instead")
    parser.add_argument("--write", action="store_true", help="write the table of latencies into docs/validation/robustness.md")
    parser.add_argument("--smoke", action="store_true", help="the smallest run of both")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if arguments.latency or arguments.smoke:
            formats = (Vendor.FEI, Vendor.JEOL) if arguments.smoke else FORMATS
            table = latency_table(latencies(arguments.latency or 1, Path(folder), arguments.seed, formats))
            sys.stdout.write(table + "\n")
            if arguments.write:
                ROBUSTNESS.write_text(write_between(ROBUSTNESS.read_text(encoding="utf-8"), "arrivals", table), encoding="utf-8")
            if not arguments.smoke:
                return 0
        result = measure(40 if arguments.smoke else arguments.files, arguments.seed, Path(folder))
    sys.stdout.write(json.dumps(result) + "\n")
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
