"""The row channel on the simulated microscope: hum and jitter as they are recovered, and false names where there is neither.

    python tests/benchmarks/bench_row_channel.py [--pairs 8] [--nulls 20]

Frames of 1024 x 884 px are rendered by the simulator without noise, at times that have nothing to do with the mains, and exposed with 2,
5 and 10 % of full scale (5, 13 and 26 grey levels). Nulls are exposed again each time, as many for each noise.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import expose

from semlive import dic
from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.settings import DicSettings
from semlive.diagnose.rows.series import RowSeries, row_series
from semlive.diagnose.rows.verdict import diagnose_rows
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.scan_deflection import MainsHum, RowJitter, Vibration
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario

PERCENT = (2, 5, 10)
Frames = list[tuple[NDArray[np.float64], NDArray[np.float64]]]
CASES: dict[str, tuple[Effect, ...]] = {
    "hum 0.020 px, 50 Hz": (MainsHum(0.02, 0.01, 50.0, 0.4),),
    "jitter 0.030 px": (RowJitter(0.03),),
    "vibration 0.020 px, 23.7 Hz": (Vibration(0.02, 0.02, 23.7),),
    "hum 0.020 px and jitter 0.030 px": (MainsHum(0.02, 0.01, 50.0, 0.4), RowJitter(0.03)),
}
SETTINGS = DicSettings(step_px=15)


def rendered(pairs: int, *effects: Effect) -> Frames:
    """Pairs of frames without noise."""
    paper = load_scenario("paper_x200")
    detector = dataclasses.replace(paper.detector, read_noise=0.0, shot_noise=0.0)
    scenario = dataclasses.replace(paper, effects=EffectSet(effects), detector=detector)
    column, rng = scenario.column(), np.random.default_rng(17)
    found, start_s = [], 2.0
    for frame in range(2 * pairs):
        found.append(render_frame(scenario, start_s, frame=frame, column=column).astype(np.float64))
        start_s += scenario.scan.frame_time_s + float(rng.uniform(0.4, 0.5))
    return list(zip(found[::2], found[1::2], strict=True))


def registered(frames: Frames, percent: float, seed: int) -> list[RowSeries]:
    """Rows of the pairs, exposed with noise."""
    scan, series = load_scenario("paper_x200").scan, []
    for pair, both in enumerate(frames):
        draw = 100_000 * percent + 1000 * seed + 2 * pair
        first, second = (expose(entry, 2.55 * percent, draw + member) for member, entry in enumerate(both))
        grid = dic.grid_for(SETTINGS, scan.width_px, scan.height_px)
        within = dic.correlate(dic.prepare(first, grid, SETTINGS), second, SETTINGS, reference_frame=0, current_frame=1)
        shifts = dic.register_rows(first, second, within, segments=24)
        series.append(row_series(shifts, scan.row_time_s, scan.dwell_time_s))
    return series


def summary(found: RowDiagnosis) -> str:
    """A verdict in a line."""
    effects = []
    for entry in found.effects:
        reported = ", ".join(f"{item.name} {item.value:.4f} +- {item.sigma:.4f}" for item in entry.parameters)
        effects.append(f"{entry.name} ({reported}; logarithm of the Bayes factor {entry.log_bayes_factor:.0f})")
    gap = "" if found.gap is None else f", gap {100 * found.gap.closure:.0f} % closed"
    return f"{found.outcome.value} {'; '.join(effects)}{gap}"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--nulls", type=int, default=20, help="for each noise")
    requests = parser.parse_args()
    for name, effects in CASES.items():
        frames = rendered(requests.pairs, *effects)
        for percent in PERCENT:
            begin = time.process_time()
            found = diagnose_rows(registered(frames, percent, 1))
            sys.stdout.write(f"{name}, noise {percent} %: {summary(found)} [{time.process_time() - begin:.1f} s]\n")
            sys.stdout.flush()
    frames, false, seeds = rendered(requests.pairs), 0, 0
    for percent in PERCENT:
        for seed in range(requests.nulls):
            found = diagnose_rows(registered(frames, percent, 2 + seed), seed)
            seeds += 1
            if found.outcome.value != "NONE":
                false += 1
                sys.stdout.write(f"null, noise {percent} %, seed {seed}: {summary(found)}\n")
    bound = 1.0 if false == seeds else float(beta.ppf(0.95, false + 1, seeds - false)) if seeds else 1.0
    sys.stdout.write(f"false names: {false} of {seeds} nulls of {requests.pairs} pairs, one-sided 95 % bound {100 * bound:.1f} %\n")


if __name__ == "__main__":
    main()
