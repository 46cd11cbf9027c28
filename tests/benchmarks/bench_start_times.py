"""What uncertain starts of scans do to strain: the numerical experiment with seven load steps, starts astray by so many seconds.

    python tests/benchmarks/bench_start_times.py --sigma-s 0.3 --seeds 2

One JSON line for each seed: rms error of the mean strains and what is stated, in 1e-6, with exact starts and with starts astray.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from numexp.asrun import decision_of
from numexp.cases import CASES
from numexp.experiment import Experiment, make_experiment

from semlive import pipeline
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.results import RunResult
from semlive.data.scan import Sourced
from semlive.data.settings import AnalysisSettings

GRID = Grid(101, 101, 15, 50, 40, 43)
COMPONENTS = ("exx", "eyy", "exy")


def concluded(experiment: Experiment, sigma_s: float, seed: int) -> RunResult:
    """The experiment through the pipeline, each start astray by a normal error."""
    rng, started = np.random.default_rng((seed, 8)), None

    def astray(info: FrameInfo) -> FrameInfo:
        start = Sourced(info.start_time_ns.value + round(rng.normal(0.0, sigma_s) * 1e9), info.start_time_ns.source)
        return replace(info, start_time_ns=start, start_sigma_s=sigma_s)

    for taken in experiment.pairs:
        decision = decision_of(taken, taken.pair, AnalysisSettings())
        decision = replace(decision, first=astray(decision.first), second=astray(decision.second))
        started = started or pipeline.start_from_maps(AnalysisSettings(), decision.first, experiment.grid)
        started = pipeline.accumulate(started, decision, taken.maps)
    if started is None:
        raise ValueError("an experiment has pairs")
    return pipeline.finalise(started)


def errors(experiment: Experiment, result: RunResult) -> dict[str, list[float]]:
    """Rms over the frames, 1e-6, for exx, eyy, exy."""
    wrong, stated = [], []
    for item in (frame.summary for frame in result.frames if frame.summary.frame > 1):
        true = experiment.pairs[item.frame // 2].observed[-1].gradient
        truth = (true[0, 0], true[1, 1], 0.5 * (true[0, 1] + true[1, 0]))
        wrong.append([getattr(item.mean, name) - value for name, value in zip(COMPONENTS, truth, strict=True)])
        stated.append([getattr(item.mean_sigma, name) for name in COMPONENTS])
    rms = {"error": wrong, "stated": stated}
    return {name: np.round(1e6 * np.sqrt(np.mean(np.square(values), axis=0)), 2).tolist() for name, values in rms.items()}


def main() -> None:
    """Print what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sigma-s", type=float, default=0.3)
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    for seed in range(arguments.seeds):
        experiment = make_experiment(CASES["tension"], seed, GRID, 9)
        reported = {str(sigma_s): errors(experiment, concluded(experiment, sigma_s, seed)) for sigma_s in (0.0, arguments.sigma_s)}
        sys.stdout.write(json.dumps({"seed": seed, "start_sigma_s": reported}) + "\n")


if __name__ == "__main__":
    main()
