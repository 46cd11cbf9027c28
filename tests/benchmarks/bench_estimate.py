"""The paper's numerical experiment over many seeds: ``python tests/benchmarks/bench_estimate.py [--seeds N] [--cases A B] [--method M]``.

Prints the table of docs/validation/estimation.md; a run over all cases and methods with at least 20 seeds also writes it there, between its
markers. 20 seeds take about 25 minutes of processor time on one core. With ``--keep FOLDER`` what was measured of every seed, case and
method is kept in a file of its own, and an interrupted run continues where it was; ``--so-far`` gives the table of what is kept.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from functools import lru_cache
from pathlib import Path

import numpy as np
from numexp.cases import CASES
from numexp.experiment import Experiment, make_experiment
from numexp.measure import Measured, measure
from numexp.methods import METHODS
from numexp.table import Results, table

from semlive.report.campaign import use_one_thread

DOCS = Path(__file__).resolve().parents[2] / "docs" / "validation" / "estimation.md"
BEGIN, END = "<!-- bench_estimate: begin -->", "<!-- bench_estimate: end -->"
ENOUGH_SEEDS = 20
SHOWN_ONCE, SHOWN_IN = ("uncorrected", "no_drift", "parametric"), ("smooth", "paper")  # what is wrong with them does not depend on the case


Job = tuple[int, tuple[str, ...], tuple[str, ...], Path | None]
"""Seed, cases of one setting, methods, and where what was measured is kept."""


def run(job: Job) -> tuple[Job, Results]:
    """All methods on the experiments of one seed and one setting."""
    seed, cases, methods, folder = job
    results: Results = {}
    for case in cases:
        for method in methods:
            if method in SHOWN_ONCE and case not in SHOWN_IN and len(methods) > 1:
                continue
            results[case, method] = [_measured(case, method, seed, folder)]
    return job, results


def _measured(case: str, method: str, seed: int, folder: Path | None) -> Measured:
    """One method on one experiment, or what is kept of it."""
    stored = None if folder is None else folder / f"{case}-{method}-{seed}.npz"
    if stored is not None and stored.exists():
        return Measured.read(stored)
    experiment = _experiment(case, seed)
    found = measure(experiment, METHODS[method](experiment))
    if stored is not None:
        unfinished = stored.with_suffix(".part.npz")
        found.write(unfinished)
        unfinished.replace(stored)
    return found


@lru_cache(maxsize=1)
def _experiment(case: str, seed: int) -> Experiment:
    return make_experiment(CASES[case], seed)


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=ENOUGH_SEEDS)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--method", choices=[*METHODS, "both", "all"], default="all")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="write the table into the documentation whatever it covers")
    parser.add_argument("--keep", type=Path, help="folder of the measured values, for a run that continues")
    parser.add_argument("--so-far", action="store_true", help="nothing is measured: the table of what the folder keeps")
    given = parser.parse_args()
    methods = {"all": tuple(METHODS), "both": ("sutton2007", "joint")}.get(given.method, (given.method,))
    settings = dict.fromkeys(CASES[name].setting for name in given.cases)
    groups = [tuple(name for name in given.cases if CASES[name].setting == item) for item in settings]
    jobs: list[Job] = [(seed, group, methods, given.keep) for seed in range(1, given.seeds + 1) for group in groups]
    if given.keep:
        given.keep.mkdir(parents=True, exist_ok=True)
    results: Results = {}
    begin = time.perf_counter()
    if given.so_far:
        results, jobs = _so_far(given.keep, given.cases, methods), []
    with multiprocessing.get_context("spawn").Pool(given.processes, initializer=use_one_thread) as pool:
        for done, (job, found) in enumerate(pool.imap_unordered(run, jobs), 1):
            for key, measured in found.items():
                results.setdefault(key, []).extend(measured)
            sys.stderr.write(f"\r{done}/{len(jobs)} seed {job[0]} {' '.join(job[1])} {time.perf_counter() - begin:.0f} s   ")
    sys.stderr.write("\n")
    lines = [*table(results, methods), "", *_speed(results)]
    counts = [f"{method} {min(len(item) for (_, by), item in results.items() if by == method)}" for method in methods]
    title = f"Seeds: {', '.join(counts)};\n95th percentile (median), or a mean over seeds ± its standard error."
    sys.stdout.write(title + "\n\n")
    sys.stdout.write("\n".join(lines) + "\n")
    whole = not given.so_far and set(methods) == set(METHODS) and set(given.cases) == set(CASES) and given.seeds >= ENOUGH_SEEDS
    if whole or given.write:
        _write([title, "", *lines])


def _so_far(folder: Path, cases: list[str], methods: tuple[str, ...]) -> Results:
    stored = {(case, method): sorted(folder.glob(f"{case}-{method}-*[0-9].npz")) for case in cases for method in methods}
    return {key: [Measured.read(path) for path in paths] for key, paths in stored.items() if paths}


def _speed(results: Results) -> list[str]:
    found = [figures for (_, method), seeds in results.items() if method == "joint" for figures in seeds if figures.update_s]
    if not found:
        return []
    update_s = float(np.median(np.concatenate([item.update_s for item in found])))
    solve_s = float(np.median([item.solve_s for item in found]))
    return [f"joint, 18,000 points: update {update_s:.2f} s per pair, solution {solve_s:.2f} s (medians, processor time)."]


def _write(lines: list[str]) -> None:
    before, rest = DOCS.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    DOCS.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + after, encoding="utf-8")


if __name__ == "__main__":
    main()
