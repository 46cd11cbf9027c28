"""Coverage of the stated intervals: ``python tests/benchmarks/bench_coverage.py [--experiments N] [--cases A B]``.

Every experiment is small (10 pairs, 30 x 24 points, no images), has drift, distortion, motion and noise of its own from the simulators'
code, and is estimated with the automatic settings. Prints the table of docs/validation/estimation.md; 500 experiments
or more of all cases also write it there, between its markers. With ``--keep FOLDER`` every experiment is stored in a file of its own,
and an interrupted run is resumed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from pathlib import Path

import numpy as np
from numexp.coverage import SMALL, Normalised, coverages, normalised, table

from semlive.report.campaign import use_one_thread

DOCS = Path(__file__).resolve().parents[2] / "docs" / "validation" / "estimation.md"
BEGIN, END = "<!-- bench_coverage: begin -->", "<!-- bench_coverage: end -->"
ENOUGH = 500
FIRST_SEED = 10_000


def run(job: tuple[str, int, Path | None]) -> tuple[str, Normalised]:
    """One experiment, or what is kept of it."""
    case, seed, folder = job
    stored = None if folder is None else folder / f"{case}-{seed}.npz"
    if stored is not None and stored.exists():
        with np.load(stored) as held:
            return case, {name: held[name] for name in held.files}
    found = normalised(SMALL[case], seed)
    if stored is not None:
        unfinished = stored.with_suffix(".part.npz")
        np.savez(unfinished, **found)
        unfinished.replace(stored)
    return case, found


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--experiments", type=int, default=ENOUGH)
    parser.add_argument("--cases", nargs="+", choices=list(SMALL), default=list(SMALL))
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder where each experiment is kept")
    parser.add_argument("--write", action="store_true", help="write the table into the documentation whatever it covers")
    given = parser.parse_args()
    if given.keep:
        given.keep.mkdir(parents=True, exist_ok=True)
    jobs = [(case, FIRST_SEED + number, given.keep) for number in range(given.experiments) for case in given.cases]
    results: dict[str, list[Normalised]] = {case: [] for case in given.cases}
    begin = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(given.processes, initializer=use_one_thread) as pool:
        for done, (case, found) in enumerate(pool.imap_unordered(run, jobs, chunksize=4), 1):
            results[case].append(found)
            sys.stderr.write(f"\r{done}/{len(jobs)} {time.perf_counter() - begin:.0f} s   ")
    sys.stderr.write("\n")
    lines: list[str] = []
    for case in given.cases:
        lines += [f"{len(results[case])} experiments, {SMALL[case].about}:", "", *table(coverages(results[case])), ""]
    sys.stdout.write("\n".join(lines))
    if given.write or (given.experiments >= ENOUGH and set(given.cases) == set(SMALL)):
        before, rest = DOCS.read_text(encoding="utf-8").split(BEGIN)
        DOCS.write_text(before + BEGIN + "\n" + "\n".join(lines) + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
