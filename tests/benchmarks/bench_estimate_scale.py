"""How the joint estimate's cost grows: ``python tests/benchmarks/bench_estimate_scale.py [--pairs N] [--anew | --live] [--step S]``.

The maps of the numerical experiment's pairs are used again and again, at later times: what is estimated is of no interest here. Prints
processor time for each update and each estimate of the newest frame after 10, 100, 300, 1000 ... pairs, time of smoothing and of a new
elimination, memory, and the batch of 15 pairs; ``--write`` puts the table into
docs/validation/estimation.md. A thousand pairs take four minutes.

``--live`` measures instead all that follows a correlation, `pipeline.add_pair`: estimate, correction of the pair's frames and of earlier
ones that moved, elastic constants, and everything that is published; and, by itself, what is due afterwards,
`pipeline.review_hyperparameters`. After 15 pairs of calibration all others are load steps: ten minutes.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numexp.asrun import decision_of
from numexp.cases import CASES
from numexp.experiment import GRID, Experiment, make_experiment
from numexp.world import HEIGHT_PX, WIDTH_PX

from semlive import estimate, pipeline
from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import AnalysisSettings, EstimateSettings
from semlive.estimate.joint.elimination.smoother import pair_covariances
from semlive.estimate.joint.solution.solver import selection_due
from semlive.report.campaign import use_one_thread

DOCS = Path(__file__).resolve().parents[2] / "docs" / "validation" / "estimation.md"
BEGIN, END = "<!-- bench_estimate_scale: begin -->", "<!-- bench_estimate_scale: end -->"
LIVE_BEGIN, LIVE_END = "<!-- bench_live: begin -->", "<!-- bench_live: end -->"
SHOWN = (10, 100, 300, 1000, 3000, 10_000)
LIVE_SHOWN = (11, 22, 100, 300, 1000)
AROUND = 5  # pairs over which a median is taken
AGAIN = 3  # times that what takes seconds is done; the shortest counts, for the machine has other work
T = TypeVar("T")


@dataclass
class Spent:
    """Processor seconds of each pair: its update, the newest frame's estimate, and what the schedule asked for."""

    update_s: list[float]
    newest_s: list[float]
    chosen_s: dict[int, float]


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """What some work gives, and its processor seconds."""
    begin = time.process_time()
    found = work()
    return found, time.process_time() - begin


def pairs_of(experiment: Experiment, count: int) -> Iterator[tuple[int, tuple[FrameTime, FrameTime], tuple[DisparityMap, ...]]]:
    """Number, times and maps of `count` pairs; after the experiment's own, those of pairs 1, 2, ... come again."""
    taken = experiment.pairs
    step_s = taken[1].times[0].start_s - taken[0].times[0].start_s
    for pair in range(count):
        like = taken[pair] if pair < len(taken) else taken[1 + (pair - 1) % (len(taken) - 1)]
        first, later_s = 2 * pair, step_s * (pair - like.pair)
        times = tuple(replace(when, frame=when.frame % 2 + first, start_s=when.start_s + later_s) for when in like.times)
        maps = tuple(
            replace(item, reference=item.reference and item.reference % 2 + first, current=item.current % 2 + first) for item in like.maps
        )
        yield pair, (times[0], times[1]), maps


def run(experiment: Experiment, count: int) -> tuple[estimate.EstimatorState, estimate.Solution, Spent]:
    """All pairs as they come in a live run: update, the newest frame, and what the schedule asks for."""
    state, solution, spent = estimate.init(EstimateSettings(), experiment.grid, WIDTH_PX, HEIGHT_PX), None, Spent([], [], {})
    phase = experiment.pairs[0].phase
    for pair, times, maps in pairs_of(experiment, count):
        before = state
        state, update_s = timed(lambda b=before, p=pair, t=times, m=maps: estimate.update(b, p, phase, t, m))
        spent.update_s.append(update_s)
        if solution is None or selection_due(pair + 1):
            solution, spent.chosen_s[pair + 1] = timed(lambda s=state, k=solution: estimate.solve_incremental(s, k))
            spent.newest_s.append(float("nan"))
        else:
            solution, newest_s = timed(lambda s=state, k=solution: estimate.solve_newest(s, k))
            spent.newest_s.append(newest_s)
        if (pair + 1) % 50 == 0:
            sys.stderr.write(f"{pair + 1}/{count}\n")
    assert solution is not None
    return state, solution, spent


def table(count: int, whole: bool, step_px: int) -> list[str]:
    """Markdown lines."""
    grid = Grid(GRID.x0_px, GRID.y0_px, step_px, GRID.nx * GRID.step_px // step_px, GRID.ny * GRID.step_px // step_px, GRID.subset_px)
    experiment = make_experiment(CASES["smooth"], 1, grid)
    batch, batch_s = [], []
    for _ in range(AGAIN):
        batch, spent_s = timed(lambda: _batch(experiment))
        batch_s.append(spent_s)
    peak_before = _peak_mb()
    state, solution, spent = run(experiment, count)
    lines = ["| pairs | update, s | newest frame, s | both, s |", "|---|---|---|---|"]
    for shown in [item for item in SHOWN if item <= count]:
        around = slice(max(shown - AROUND, 0), shown)
        update_s, newest_s = float(np.median(spent.update_s[around])), float(np.nanmedian(spent.newest_s[around]))
        lines.append(f"| {shown} | {update_s:.3f} | {newest_s:.3f} | {update_s + newest_s:.3f} |")
    ran_mb = _peak_mb()
    smoothed, smooth_s = timed(lambda: estimate.solve_incremental(state, solution))
    spread_s = min(timed(lambda: sum(1 for _ in pair_covariances(smoothed.shared_posterior)))[1] for _ in range(AGAIN))
    smoothed_mb = _peak_mb()
    _, published_s = timed(lambda: estimate.to_estimate(smoothed, count))
    again = ""
    if whole:
        _, again_s = timed(lambda: estimate.solve(state))
        again = f" All again from the block means of the maps: {again_s:.1f} s, {_peak_mb():.0f} MB at most."
    last, last_s = max(spent.chosen_s.items())
    chosen_s = sum(spent.chosen_s.values())
    lines += [
        "",
        f"After {count} pairs: smoothed means of all pairs {smooth_s:.2f} s, with their covariances {smooth_s + spread_s:.2f} s,",
        f"with all published results {smooth_s + published_s:.2f} s. Scheduled reviews took {chosen_s:.1f} s in total,",
        f"{chosen_s / count:.3f} s per pair; the last time, after {last} pairs, {last_s:.1f} s. Memory at most {ran_mb:.0f} MB in the run,",
        f"{smoothed_mb:.0f} MB with smoothing; {peak_before:.0f} MB of it before the run.{again} Batch of {len(batch)} pairs:",
        f"{min(batch_s):.2f} s. Processor time, {grid.nx * grid.ny:,} points, one core.",
    ]
    return lines


def live_table(count: int) -> list[str]:
    """Markdown lines: what one pair costs the pipeline from its disparity maps on."""
    experiment = make_experiment(CASES["tension"], 1)
    plain = AnalysisSettings()
    settings = replace(plain, specimen=replace(plain.specimen, area_mm2=1.0))
    taken = experiment.pairs
    steps = [item for item in taken if item.phase is Phase.TENSION]
    started, spent, revised = pipeline.start_from_maps(settings, decision_of(taken[0], 0, settings).first, experiment.grid), [], []
    due: dict[int, float] = {}
    for pair in range(count):
        like = taken[pair] if pair < len(taken) else steps[(pair - len(taken)) % len(steps)]
        first, decision = 2 * pair, decision_of(like, pair, settings)
        maps = tuple(
            replace(item, reference=item.reference and item.reference % 2 + first, current=item.current % 2 + first) for item in like.maps
        )
        (started, result), spent_s = timed(lambda b=started, d=decision, m=maps: pipeline.add_pair(b, d, m))
        spent.append(spent_s)
        (started, reviewed), spent_s = timed(lambda b=started: pipeline.review_hyperparameters(b))
        if reviewed:
            due[pair + 1] = spent_s
        revised.append(len(result.revised_frames) + (len(reviewed.revised_frames) if reviewed else 0))
        if (pair + 1) % 50 == 0:
            sys.stderr.write(f"{pair + 1}/{count}\n")
    lines = ["| pairs | from maps to published results, s | slowest of ten | frames revised so far |", "|---|---|---|---|"]
    for shown in [item for item in LIVE_SHOWN if item <= count]:
        around = spent[max(shown - 10, 0) : shown]
        lines.append(f"| {shown} | {float(np.median(around)):.2f} | {max(around):.2f} | {sum(revised[:shown])} |")
    at = ", ".join(f"{spent_s:.1f} s after {pair}" for pair, spent_s in due.items() if pair >= 16)
    due_text = f"Scheduled review after the pair is published: {at}. Processor time, 18,000 points, one core."
    return [*lines, "", *textwrap.wrap(due_text, 118)]


def _batch(experiment: Experiment) -> list[float]:
    state = estimate.init(EstimateSettings(), experiment.grid, WIDTH_PX, HEIGHT_PX)
    for taken in experiment.pairs:
        state = estimate.update(state, taken.pair, taken.phase, taken.times, taken.maps)
    return [item.start_s for item in estimate.solve(state).state.frames[::2]]


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--step", type=int, default=GRID.step_px, help="distance of points over the same field, px; not for --live")
    parser.add_argument("--write", action="store_true", help="write the table into the documentation")
    parser.add_argument("--live", action="store_true", help="measure what follows a correlation in a live run")
    parser.add_argument("--anew", action="store_true", help="also solve the complete run without the results stored from pair to pair")
    given = parser.parse_args()
    with multiprocessing.get_context("spawn").Pool(1, initializer=use_one_thread) as pool:
        lines = pool.apply(live_table, (given.pairs,)) if given.live else pool.apply(table, (given.pairs, given.anew, given.step))
    sys.stdout.write("\n".join(lines) + "\n")
    if given.write:
        begin, end = (LIVE_BEGIN, LIVE_END) if given.live else (BEGIN, END)
        before, rest = DOCS.read_text(encoding="utf-8").split(begin)
        after = rest.split(end)[1]
        DOCS.write_text(before + begin + "\n" + "\n".join(lines) + "\n" + end + after, encoding="utf-8")


if __name__ == "__main__":
    main()
