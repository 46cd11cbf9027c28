"""Runs without any effect, imported without a hint about the subset, over noise of many shapes: false names and UNKNOWN.

    python tests/benchmarks/bench_noise_shapes.py --runs 100 --folder shapes [--shapes square round] [--shard 1/2] [--seconds 600]
    python tests/benchmarks/bench_noise_shapes.py --folder shapes --score [--write]

The generator (tests/benchmarks/foreign) shares no code with the estimator, the diagnosis or the simulators: drift over scan time,
distortion, shifts and strain at every point, and white noise of the pixels seen through the weights of a subset. A run has 7 pairs of 640 x
552 px with 32 x 27 points 16 px apart. Interrupted runs continue where they stopped.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from foreign.noise import SHAPES
from foreign.world import Raster, Series, write
from scipy.stats import beta

from semlive.service.diagnosis.run import diagnose_log
from semlive.service.log.opened_log import OpenedLog
from semlive.service.replay.import_maps import ImportRequest, import_folder

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "diagnosis.md"
BEGIN, END = "<!-- noise shapes: begin -->\n", "<!-- noise shapes: end -->\n"
RASTER = Raster(width=640, height=552, step_px=16, margin_px=64)
PAIRS = 4, 3
FIRST_SEED = 700_001
Verdict = dict[str, Any]


def main() -> None:
    """Run what is missing, or score what is there."""
    arguments = _arguments()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    if not arguments.score:
        _run(arguments)
    found = table(verdicts(arguments.folder))
    sys.stdout.write(found)
    if arguments.write:
        page = PAGE.read_text(encoding="utf-8")
        before, rest = page.split(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{found}\n{END}{rest.split(END)[1]}", encoding="utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1, help="of each shape")
    parser.add_argument("--shapes", nargs="*", default=list(SHAPES), choices=list(SHAPES))
    parser.add_argument("--shard", default="1/1", help="k/n: every n-th run from the k-th on")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--folder", type=Path, default=Path("shapes"))
    parser.add_argument("--score", action="store_true", help="run nothing")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    return parser.parse_args()


def _run(arguments: argparse.Namespace) -> None:
    own, shards = (int(part) for part in arguments.shard.split("/"))
    begin, done = time.monotonic(), {(line["shape"], line["seed"]) for line in verdicts(arguments.folder)}
    cases = [(shape, FIRST_SEED + run) for run in range(arguments.runs) for shape in arguments.shapes]
    for shape, seed in cases[own - 1 :: shards]:
        if time.monotonic() - begin > arguments.seconds:
            return
        if (shape, seed) not in done:
            with (arguments.folder / f"verdicts-{own}-of-{shards}.jsonl").open("a", encoding="utf-8") as stream:
                stream.write(json.dumps({"shape": shape, "seed": seed, **verdict_of(shape, seed)}) + "\n")


def verdict_of(shape: str, seed: int) -> Verdict:
    """Verdict on one run without effects."""
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name) / "maps", Path(name) / "maps.mcap"
        write(Series(seed, *PAIRS, raster=RASTER), SHAPES[shape], folder)
        imported = import_folder(ImportRequest(folder, log))
        begin = time.process_time()
        found, _ = diagnose_log(OpenedLog(log))
        return {
            "outcome": found.outcome.value,
            "names": [effect.name for effect in found.effects],
            "edge_px": imported.noise.subset_px,
            "cpu_s": time.process_time() - begin,
            "memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
            "largest": max(found.evidence, key=lambda item: item[1]),
            "adequacy": None if found.adequacy is None else (found.adequacy.domain, found.adequacy.p_value),
        }


def verdicts(folder: Path) -> list[Verdict]:
    """All there are."""
    return [json.loads(line) for path in sorted(folder.glob("verdicts-*.jsonl")) for line in path.read_text(encoding="utf-8").splitlines()]


def table(lines: list[Verdict]) -> str:
    """Counts of each shape and of all, with the upper limit of the false fraction at 95 %."""
    by_shape: dict[str, list[Verdict]] = defaultdict(list)
    for line in lines:
        by_shape[line["shape"]].append(line)
    heads = ["noise", "runs", "NONE", "named", "UNKNOWN", "false, at most (95 %)", "estimated edge, px", "CPU, s"]
    rows = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    rows += [_row(shape, by_shape[shape]) for shape in SHAPES if shape in by_shape]
    if lines:
        rows.append(_row("all", lines))
        rows += ["", f"Largest memory of a process {max(line['memory_gb'] for line in lines):.2f} GB."]
    return "\n".join([*rows, ""])


def _row(name: str, lines: list[Verdict]) -> str:
    none = sum(line["outcome"] == "NONE" for line in lines)
    named = sum(bool(line["names"]) for line in lines)
    false, count = len(lines) - none, len(lines)
    bound = 100.0 * float(beta.ppf(0.95, false + 1, count - false)) if false < count else 100.0
    edges = np.quantile([line["edge_px"] for line in lines], (0.0, 0.5, 1.0))
    unknown, slowest = false - named, max(line["cpu_s"] for line in lines)
    edge = f"{edges[1]:.0f} ({edges[0]:.0f} to {edges[2]:.0f})"
    return f"| {name} | {count} | {none} | {named} | {unknown} | {bound:.1f} % | {edge} | {slowest:.1f} |"


if __name__ == "__main__":
    main()
