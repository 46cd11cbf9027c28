"""Waves near multiples of the row rate in the maps within pairs: identified frequencies and amplitudes, and runs without a wave.

    python tests/benchmarks/bench_map_waves.py --runs 20 --nulls 100 [--write]

The maps come from a generator that shares no code with semlive: a plane wave with a phase of its own in each frame and white noise, both
averaged over subsets of 43 px, plus a drift over the rows. Six pairs of 150 x 120 points, 0.02 px of noise in each frame. A tenth of the
runs without a wave is repeated with 30 pairs, and with maps that are smoothed by 25 px as well.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parent))

from blind.campaign import PAGE

from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import Outcome
from semlive.diagnose.rows.map_series import MapSeries, make_map_series
from semlive.diagnose.rows.map_waves import MIN_LOG_FACTOR, diagnose_map_waves

WIDTH_PX, HEIGHT_PX, SUBSET_PX, PAIRS, NOISE_PX = 1024, 884, 43, 6, 0.02
MANY_PAIRS, SMOOTHED_PX = 30, 72
ROW_TIME_S, DWELL_TIME_S = 94.67 / HEIGHT_PX, 1e-4
COLUMNS, ROWS = 101.0 + 5.0 * np.arange(150), 101.0 + 5.0 * np.arange(120)
WAVES = ((9.5, 0.05), (37.3, 0.10), (37.3, 0.05), (18.74, 0.05), (18.74, 0.02), (46.6, 0.01))  # Hz and px; rows come at 9.338 Hz


def simulated(frequency_hz: float, amplitude_px: float, seed: int, pairs: int = PAIRS, smooth_px: float = 0.0) -> list[MapSeries]:
    """Maps within pairs with a wave in both components; smoothed ones have subsets of 72 px, as an import estimates."""
    rng = np.random.default_rng((seed, 38))
    y, x = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX]
    phase = 2.0 * np.pi * frequency_hz * (y * ROW_TIME_S + x * DWELL_TIME_S)
    found = []
    for _ in range(pairs):
        values: list[NDArray[np.float64]] = []
        for _ in range(2):
            frames = [amplitude_px * np.cos(phase + rng.uniform(0.0, 2.0 * np.pi)) for _ in range(2)]
            noise = rng.normal(0.0, np.sqrt(2.0) * NOISE_PX * SUBSET_PX, phase.shape)
            drift = 0.3 * y / HEIGHT_PX + 0.1 * (y / HEIGHT_PX) ** 2
            observed = uniform_filter(frames[1] - frames[0] + noise + drift, SUBSET_PX)
            observed = gaussian_filter(observed, smooth_px) if smooth_px else observed
            values.append(observed[np.ix_(ROWS.astype(int), COLUMNS.astype(int))])
        valid = np.ones(values[0].shape, dtype=np.bool_)
        edge_px = SMOOTHED_PX if smooth_px else SUBSET_PX
        found.append(make_map_series(values, valid, (ROWS, COLUMNS), float(edge_px), (ROW_TIME_S, DWELL_TIME_S)))
    return found


def verdict(frequency_hz: float, amplitude_px: float, seed: int, pairs: int = PAIRS, smooth_px: float = 0.0) -> RowDiagnosis:
    """Verdict on one run."""
    found = diagnose_map_waves(simulated(frequency_hz, amplitude_px, seed, pairs, smooth_px))
    assert found is not None  # these maps resolve waves
    return found


def table(runs: int, nulls: int) -> str:
    """Markdown table over all waves, and a line on runs without one."""
    lines = [
        "| wave | identified | largest error of f | amplitude along x, median | wrong f |",
        "|---|---|---|---|---|",
    ]
    for frequency_hz, amplitude_px in WAVES:
        effects = [effect for seed in range(runs) for effect in verdict(frequency_hz, amplitude_px, seed).effects]
        values = [{parameter.name: parameter.value for parameter in effect.parameters} for effect in effects]
        errors_hz = [abs(value["frequency_hz"] - frequency_hz) for value in values]
        right = [error for error in errors_hz if error < 0.01]
        size = f"{np.median([value['amplitude_x_px'] for value in values]):.4f} px" if values else ""
        lines.append(
            f"| {frequency_hz:g} Hz, {amplitude_px:.2f} px | {len(right)} of {runs} | {max(right, default=0.0):.4f} Hz | {size} | "
            f"{len(errors_hz) - len(right)} |"
        )
    without = [_without(f"{PAIRS} pairs", [verdict(0.0, 0.0, 1000 + seed) for seed in range(nulls)])]
    for smooth_px, name in ((0.0, f"{MANY_PAIRS} pairs"), (25.0, f"{MANY_PAIRS} pairs of smoothed maps")) if nulls >= 10 else ():
        without.append(_without(name, [verdict(0.0, 0.0, 2000 + seed, MANY_PAIRS, smooth_px) for seed in range(nulls // 10)]))
    return "\n".join([*lines, "", f"Without a wave (limit of ln B {MIN_LOG_FACTOR:.0f}):", "", *without])


def _without(name: str, results: list[RowDiagnosis]) -> str:
    named, runs = sum(result.outcome is not Outcome.NONE for result in results), len(results)
    largest = max(factor for result in results for _, factor in result.evidence)
    bound = float(beta.ppf(0.95, named + 1, runs - named)) if named < runs else 1.0
    return f"- {name}: {named} of {runs} have one (at most {100 * bound:.1f} %, 95 %); largest ln B {largest:.1f}"


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    requests = parser.parse_args()
    found = table(requests.runs, requests.nulls)
    sys.stdout.write(found + "\n")
    if requests.write:
        first, last = "<!-- map waves: begin -->\n", "<!-- map waves: end -->\n"
        before, rest = PAGE.read_text(encoding="utf-8").split(first)
        PAGE.write_text(f"{before}{first}\n{found}\n\n{last}{rest.split(last)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
