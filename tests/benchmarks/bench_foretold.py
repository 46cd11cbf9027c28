"""What experiments are foretold to decide between two effects, against what simulations of them do decide.

    python tests/benchmarks/bench_foretold.py [--first 3] [--second 4] [--times 3] [--write]

A run of 15 pairs with one of two easily confused effects, at so many times the detection limit, determines how large both
would be; this forecasts the logarithm of the odds that an experiment gives for the true one. Then the experiment is simulated (another
drift, other stage errors, other noise; the simulators' own effects, at displacement level, 0.02 px of noise shared over subsets, 1 % of the
points missing, 0.1 % wrong), and its data give the odds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from blind.experiment import Conditions
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import observed
from blind.scoring import at_least
from numexp.world import SCAN

from semlive.data.grid import Grid
from semlive.diagnose.baseline.bayes_factor import score_candidates
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.experiments.expected_odds import expected_odds, log_odds, predict_effect
from semlive.diagnose.experiments.forecast import planned_run
from semlive.diagnose.experiments.proposals import ExperimentKind
from semlive.diagnose.experiments.simulated_run import simulate_baseline
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS
from semlive.diagnose.maps.refinement import refined
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.microscope.scan import Scan

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "diagnosis.md"
BEGIN, END = "<!-- foretold: begin -->\n", "<!-- foretold: end -->\n"
GRID = Grid(101, 101, 30, 25, 20, 43)
FIRST_SEED, SECOND_SEED = 60_001, 61_001
CONFUSABLE = (  # the true one first
    ("magnification_drift", "refocus_magnification_step"),
    ("raster_rotation_drift", "stage_yaw"),
    ("stage_yaw", "raster_rotation_drift"),
    ("wrong_row_time", "scan_shear_drift"),
    ("scan_shear_drift", "wrong_row_time"),
    ("aspect_drift", "distortion_scale_drift"),
    ("distortion_scale_drift", "magnification_drift"),
)
DRAWN = ("stage_yaw",)
"""Another run has amplitudes of its own."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One experiment.

    Attributes:
        true: what is hidden.
        other: what it could be taken for.
        kind: of the experiment.
        dwell: of the scan, of that of the first run.
        foretold: logarithm of the odds for the true one.
        given: by the data of each simulation.
    """

    true: str
    other: str
    kind: ExperimentKind
    dwell: float
    forecast: float
    given: tuple[float, ...]


def main() -> None:
    """Forecast, simulate, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=3, help="runs with a forecast, of each pair of effects")
    parser.add_argument("--second", type=int, default=4, help="simulations of each experiment")
    parser.add_argument("--times", type=float, default=3.0, help="what can be detected")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    requests = parser.parse_args()
    comparisons = []
    for true, other in CONFUSABLE:
        for seed in range(FIRST_SEED, FIRST_SEED + requests.first):
            for item in compared(true, other, requests.times, seed, requests.second):
                comparisons.append(item)
                sys.stdout.write(f"{item}\n")
                sys.stdout.flush()
    found = table(comparisons)
    sys.stdout.write(found)
    if requests.write:
        page = PAGE.read_text(encoding="utf-8")
        before, rest = page.split(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{found}\n{END}{rest.split(END)[1]}", encoding="utf-8")


def compared(true: str, other: str, times: float, seed: int, second: int) -> Iterator[Comparison]:
    """All experiments after one run."""
    size_px = times * PROTOTYPE_PX[true]
    first = observed(Conditions(seed), hidden_effect(true, size_px, seed), GRID)
    before = noise_scaled_baseline(first)
    rivals = [refined(before, item) for item in score_candidates(before, [effect_class(true), effect_class(other)])]
    for kind, dwell in (
        (ExperimentKind.STATIONARY_SERIES, 1.0),
        (ExperimentKind.REPEAT, 1.0),
        (ExperimentKind.CHANGED_SCAN_TIMES, 0.5),
        (ExperimentKind.CHANGED_SCAN_TIMES, 2.0),
    ):
        ahead = simulate_baseline(before, planned_run(first, kind, dwell))
        forecast = expected_odds(ahead, [predict_effect(ahead, before, item) for item in rivals])[0, 1]
        given = []
        for number in range(second):
            own = SECOND_SEED + 100 * (seed - FIRST_SEED) + number
            after = noise_scaled_baseline(observed(_conditions(kind, dwell, own, seed), _effects(true, size_px, seed, own), GRID))
            given.append(float(log_odds(after, [predict_effect(after, before, item) for item in rivals])[0, 1]))
        yield Comparison(true, other, kind, dwell, float(forecast), tuple(given))


def _effects(true: str, size_px: float, seed: int, own: int) -> tuple[Effect, ...]:
    return hidden_effect(true, size_px, own if true in DRAWN else seed)


def _conditions(kind: ExperimentKind, dwell: float, seed: int, bent_like: int) -> Conditions:
    parked = kind is ExperimentKind.STATIONARY_SERIES
    given = Conditions(seed, calibration=10 if parked else 8, tension=0, bent_like=bent_like, parked=parked, scan=_scan(dwell))
    return replace(given, noise_px=given.noise_px / dwell**0.5)


def _scan(dwell: float) -> Scan:
    return replace(SCAN, dwell_time_s=dwell * SCAN.dwell_time_s, frame_time_s=dwell * SCAN.frame_time_s)


def table(comparisons: list[Comparison]) -> str:
    """By effect and experiment; then how often the true one won, where the forecast odds exceed 20, and elsewhere."""
    lines = ["| true effect | rival | experiment | ln odds, forecast | simulated: mean | minimum |", "|---|---|---|---|---|---|"]
    for key in dict.fromkeys((item.true, item.other, item.kind, item.dwell) for item in comparisons):
        own = [item for item in comparisons if (item.true, item.other, item.kind, item.dwell) == key]
        given = np.concatenate([item.given for item in own])
        what = key[2].value.replace("_", " ") + ("" if key[3] == 1.0 else f", {key[3]:g} times the dwell")
        mean = float(np.mean([item.forecast for item in own]))
        lines.append(f"| `{key[0]}` | `{key[1]}` | {what} | {mean:.1f} | {given.mean():.1f} | {given.min():.1f} |")
    lines.append("")
    for sure, printed in ((True, "more than 20"), (False, "20 or less")):
        given = [item for each in comparisons if (each.forecast > MIN_LOG_ODDS) == sure for item in each.given]
        won = sum(item > 0.0 for item in given)
        if given:
            least = 100.0 * at_least(won, len(given))
            lines.append(f"Forecast odds of {printed}: the true effect was preferred in {won} of {len(given)} (at least {least:.1f} %).")
            lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
