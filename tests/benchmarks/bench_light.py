"""Residual test after every pair of a run: rate of false warnings, delay of a warning with a hidden effect, and cost.

    python tests/benchmarks/bench_light.py --nulls 9001 9301     # runs of 8 to 15 pairs: from a seed to before another
    python tests/benchmarks/bench_light.py --effects --size 4    # each effect of the library at so many times what can be detected
    python tests/benchmarks/bench_light.py --cost                # processor time of a look, 18,000 points

Truth and noise are the simulators' own, at displacement level; estimates follow pair by pair as in the daemon.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from scipy.stats import beta
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parent))

from blind.cases import GRID, NOTHING, Case
from blind.experiment import GRID as FULL
from blind.experiment import Conditions, hidden
from blind.hiding import DETECTABLE_PX, hidden_effect
from blind.live import decided
from numexp.world import HEIGHT_PX, WIDTH_PX

from semlive import estimate
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.diagnose.fit_tests.adequacy import Adequacy, adequacy_after
from semlive.estimate.joint.solution.solver import selection_due
from semlive_simulators.effects.interfaces import Effect


def print_line(line: str) -> None:
    """At once, so that a long bench can be watched."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def looks(conditions: Conditions, effects: tuple[Effect, ...], grid: Grid = GRID) -> Iterator[tuple[Adequacy | None, float]]:
    """After each pair what is found, and what looking took, s of processor time."""
    state, solution, decisions = estimate.init(EstimateSettings(), grid, WIDTH_PX, HEIGHT_PX), None, []
    for item in hidden(conditions, effects, grid):
        state = estimate.update(state, item.pose.pair, item.pose.phase, item.times, item.maps)
        solution = estimate.solve_live(state, solution)
        decisions.append(decided(item))
        if selection_due(len(decisions)):
            solution = estimate.solve_incremental(state, solution)
        began = time.process_time()
        yield adequacy_after(solution, decisions), time.process_time() - began


def warned(conditions: Conditions, effects: tuple[Effect, ...]) -> Adequacy | None:
    """The first look of a run that warns."""
    return next((found for found, _ in looks(conditions, effects) if found is not None and found.most_significant is not None), None)


def nulls(first: int, beyond: int) -> None:
    """Runs in which nothing is hidden."""
    alarms = 0
    for done, seed in enumerate(range(first, beyond), start=1):
        found = warned(Case(NOTHING, (), 0.0, seed).conditions(), ())
        alarms += found is not None
        if found is not None:
            print_line(f"seed {seed}: {found.notes()[0].text}")
        if done % 10 == 0 or seed == beyond - 1:
            bound = float(beta.ppf(0.95, alarms + 1, done - alarms))
            print_line(f"{alarms} of {done} runs warned: at most {100 * bound:.1f} % (one-sided 95 %)")


def effects(size: float, seed: int) -> None:
    """Each effect once."""
    for name in DETECTABLE_PX:
        found = warned(Conditions(seed), hidden_effect(name, size * DETECTABLE_PX[name], seed))
        reported = (
            "no warning"
            if found is None or found.most_significant is None
            else f"after {found.pairs} pairs, by {found.most_significant.domain}"
        )
        print_line(f"{name:32} {reported}")


def cost() -> None:
    """A run of 22 pairs at the usual grid."""
    for pairs, (_, took_s) in enumerate(looks(Conditions(1, tension=14), (), FULL), start=1):
        print_line(f"{pairs:3} pairs: {1e3 * took_s:6.0f} ms")


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nulls", type=int, nargs=2, metavar=("FROM", "TO"))
    parser.add_argument("--effects", action="store_true")
    parser.add_argument("--size", type=float, default=4.0)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cost", action="store_true")
    requests = parser.parse_args()
    with threadpool_limits(limits=1, user_api="blas"):
        if requests.nulls:
            nulls(*requests.nulls)
        if requests.effects:
            effects(requests.size, requests.seed)
        if requests.cost:
            cost()


if __name__ == "__main__":
    main()
