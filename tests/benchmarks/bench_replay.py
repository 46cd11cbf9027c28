"""Replay of a long log from disparity: ``python tests/benchmarks/bench_replay.py [--pairs N] [--runs N] [--threads N] [--write]``.

Makes a log of N pairs by `semlive import` (the maps of the numerical experiment's pairs again and again, at later times, as text
files), and replays it with `semlive replay --from-disparity --json`, each time in a process of its own. Prints pairs per second by
processor and by wall time, and the process's peak memory; ``--write`` puts the table into docs/validation/performance.md. The
default, 1,000 pairs of 18,000 points, takes 1.5 GB of disk and twice as much again while it is replayed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from numexp.asfolder import HEADER, frame_lines, map_text
from numexp.cases import CASES
from numexp.experiment import Experiment, make_experiment

from semlive.data.grid import Grid

DOCS = Path(__file__).resolve().parents[2] / "docs" / "validation" / "performance.md"
BEGIN, END = "<!-- bench_replay: begin -->", "<!-- bench_replay: end -->"


def write_long_folder(experiment: Experiment, count: int, folder: Path) -> None:
    """A folder of `count` pairs; after the experiment's own its pairs 1, 2, ... come again, as links to the same files."""
    taken = experiment.pairs
    step_s = taken[1].times[0].start_s - taken[0].times[0].start_s
    lines = [HEADER]
    stored: dict[tuple[int, int], Path] = {}
    for pair in range(count):
        like = taken[pair] if pair < len(taken) else taken[1 + (pair - 1) % (len(taken) - 1)]
        later = replace(like, times=(like.times[0], like.times[1]))
        lines += frame_lines(later, pair, step_s * (pair - like.pair), 1.0)
        for item in like.maps:
            if item.reference == 0 and item.current % 2 and item.current > 1:
                continue
            current = 2 * pair + item.current % 2
            reference = item.reference and 2 * pair
            path = folder / f"disparity_{reference}_{current}.csv"
            same = stored.get((item.reference, item.current))
            if same is None:
                path.write_text(map_text(item, 6))
                stored[item.reference, item.current] = path
            else:
                path.symlink_to(same)
    (folder / "frames.csv").write_text("\n".join([*lines, ""]))


def timed(arguments: list[str], count: int | None = None) -> tuple[str, float, float, float]:
    """Standard output, processor and wall seconds, and peak memory in MB of `semlive ARGUMENTS` in a process of its own."""
    # The peak is the kernel's figure for this program (VmHWM): ru_maxrss begins with the parent's.
    script = (
        "import re, sys, time; from semlive.cli.app import run_app; sys.argv[0] = 'semlive'; code = run_app(); "
        "peak = int(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1]) / 1024; "
        "sys.stderr.write(f'{time.process_time()} {peak}'); sys.exit(code)"
    )
    threads = {} if count is None else {"NUMBA_NUM_THREADS": str(count)}
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, env={**os.environ, **threads}, check=False
    )
    wall_s = time.perf_counter() - begin
    if done.returncode:
        raise RuntimeError(done.stderr)
    cpu_s, peak_mb = map(float, done.stderr.splitlines()[-1].split())
    return done.stdout, cpu_s, wall_s, peak_mb


def experiment_of(step_px: int) -> Experiment:
    """The numerical experiment's calibration and load steps, on a grid of that step."""
    return make_experiment(CASES["tension"], 1, Grid(101, 101, step_px, 745 // step_px + 1, 595 // step_px + 1, 0))


def measured(experiment: Experiment, count: int, folder: Path, runs: int, threads: int | None) -> list[str]:
    """Markdown lines: a row for each replay of the same log."""
    grid = experiment.grid
    maps, log = folder / "maps", folder / "long.mcap"
    maps.mkdir()
    write_long_folder(experiment, count, maps)
    _, import_s, _, import_mb = timed(["import", str(maps), "-o", str(log), "--specimen-area-mm2", "1.0", "--subset-px", "43"], threads)
    size_mb = log.stat().st_size / 2**20
    rows, printed = [], set()
    for _ in range(runs):
        out, cpu_s, wall_s, peak_mb = timed(["replay", str(log), "--from-disparity", "--json"], threads)
        reported = json.loads(out)
        assert reported["pairs"] == count
        assert len(reported["frames"]) == 2 * count
        printed.add(out)
        rows.append(
            f"| {count} | {grid.nx * grid.ny} | {size_mb:.0f} | {count / import_s:.0f} | {import_mb:.0f} "
            f"| {count / cpu_s:.1f} | {count / wall_s:.1f} | {peak_mb:.0f} |"
        )
    assert len(printed) == 1  # to the last bit, however the work was dealt out
    return [
        "| pairs | points | log, MB | import, pairs/s | its memory, MB | "
        "replay, pairs/s of processor time | by the clock | its memory, MB |",
        "|---|---|---|---|---|---|---|---|",
        *rows,
    ]


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--step", type=int, default=5, help="distance of points in px; 5 gives 18,000 points")
    parser.add_argument("--runs", type=int, default=1, help="replays of the same log")
    parser.add_argument("--threads", type=int, help="threads of the process; as many as there are processors by default")
    parser.add_argument("--write", action="store_true", help="write the table into the documentation")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="semlive-bench-") as folder:
        lines = measured(experiment_of(given.step), given.pairs, Path(folder), given.runs, given.threads)
    sys.stdout.write("\n".join(lines) + "\n")
    if given.write:
        before, rest = DOCS.read_text(encoding="utf-8").split(BEGIN)
        DOCS.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
