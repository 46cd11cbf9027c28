"""The paper's numerical experiment over many seeds: ``python tests/benchmarks/bench_estimate.py [--seeds N] [--cases A B] [--method M]``.

Prints the table of docs/estimation.md; a run over all cases and methods with at least 20 seeds also writes it there, between its
markers. 20 seeds take about 25 minutes of processor time on one core.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from pathlib import Path

import numpy as np
from numexp.cases import CASES
from numexp.experiment import make_experiment
from numexp.measure import Measured, measure
from numexp.methods import METHODS
from numexp.table import Results, table

DOCS = Path(__file__).resolve().parents[2] / "docs" / "estimation.md"
BEGIN, END = "<!-- bench_estimate: begin -->", "<!-- bench_estimate: end -->"
ENOUGH_SEEDS = 20


def one(job: tuple[str, int, tuple[str, ...]]) -> tuple[str, int, dict[str, Measured]]:
    """All methods on one experiment."""
    case, seed, methods = job
    experiment = make_experiment(CASES[case], seed)
    return case, seed, {method: measure(experiment, METHODS[method](experiment)) for method in methods}


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=ENOUGH_SEEDS)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--method", choices=[*METHODS, "both", "all"], default="all")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    methods = {"all": tuple(METHODS), "both": ("sutton2007", "joint")}.get(given.method, (given.method,))
    jobs = [(case, seed, methods) for seed in range(1, given.seeds + 1) for case in given.cases]
    results: Results = {}
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read by the processes that are spawned next
    begin = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(given.processes) as pool:
        for done, (case, seed, measured) in enumerate(pool.imap_unordered(one, jobs), 1):
            for method, figures in measured.items():
                results.setdefault((case, method), []).append(figures)
            sys.stderr.write(f"\r{done}/{len(jobs)} {case} seed {seed} {time.perf_counter() - begin:.0f} s   ")
    sys.stderr.write("\n")
    lines = [*table(results, methods), "", *_speed(results)]
    sys.stdout.write(f"{given.seeds} seeds: 95th percentile (median), or a mean over seeds ± its standard error\n\n")
    sys.stdout.write("\n".join(lines) + "\n")
    if set(methods) == set(METHODS) and set(given.cases) == set(CASES) and given.seeds >= ENOUGH_SEEDS:
        _write([f"{given.seeds} seeds: 95th percentile (median), or a mean over seeds ± its standard error.", "", *lines])


def _speed(results: Results) -> list[str]:
    found = [figures for (_, method), seeds in results.items() if method == "joint" for figures in seeds if figures.update_s]
    if not found:
        return []
    update_s = float(np.median(np.concatenate([one.update_s for one in found])))
    solve_s = float(np.median([one.solve_s for one in found]))
    return [f"joint, 18,000 points: update {update_s:.2f} s per pair, solution {solve_s:.2f} s (medians, processor time)."]


def _write(lines: list[str]) -> None:
    before, rest = DOCS.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    DOCS.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + after, encoding="utf-8")


if __name__ == "__main__":
    main()
