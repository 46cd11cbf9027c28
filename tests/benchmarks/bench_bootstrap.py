"""Agreement of the linearised bootstrap, which gives the p-values, with complete refits.

    python tests/benchmarks/bench_bootstrap.py --refits 60 [--seeds 3] [--folder refits] [--shard 1/2] [--score]

An experiment with nothing hidden in it (15 pairs, 0.02 px of noise shared over subsets) is measured again and again: the same drift, the
same distortion, the same specimen, other noise, other lost and wrong points. Each is estimated from the start, its noise measured again,
and every family scored; the most significant is compared with that of each of the 299 linearised draws of the first measurement. The
share of refits whose p-value by those draws is below a level is that level where the bootstrap is right. What is done is
kept in the folder.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from blind.cases import GRID
from blind.experiment import Conditions
from blind.observing import observed
from scipy.stats import ks_2samp

from semlive.diagnose.baseline.bayes_factor import NullDraws, score_candidates, with_draws
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.maps.unnamed_fields import UNNAMED_CLASSES
from semlive.diagnose.maps.verdict import DRAWS
from semlive.model.effects import EFFECT_CLASSES

FIRST_SEED, NOISE = 60_001, 700_000
FAMILIES = (*EFFECT_CLASSES, *UNNAMED_CLASSES)
LEVELS = (0.01, 0.05, 0.1, 0.2, 0.5)


def linear(seed: int) -> list[float]:
    """The most significant family of each draw."""
    plain = noise_scaled_baseline(observed(Conditions(seed), (), GRID))
    received = with_draws(plain, score_candidates(plain, FAMILIES), NullDraws.of(plain, DRAWS, seed))
    return [float(item) for item in np.max([item.null for item in received], axis=0)]


def refitted(seed: int, number: int) -> float:
    """The most significant family where all is measured and estimated again."""
    plain = noise_scaled_baseline(observed(Conditions(seed, noise_seed=NOISE + 1000 * (seed - FIRST_SEED) + number), (), GRID))
    return max(item.log_factor for item in score_candidates(plain, FAMILIES))


def comparison(drawn: dict[int, list[float]], found: dict[int, list[float]]) -> str:
    """Both, side by side."""
    lines = ["| experiment | refits | median, draws | refits | 90 %, draws | refits | largest, draws | refits | p of a difference |"]
    lines.append("|---" * 9 + "|")
    p_values = []
    for seed, draws in drawn.items():
        refits = found.get(seed, [])
        if not refits:
            continue
        cells = [f"{np.quantile(item, share):.2f}" for share in (0.5, 0.9, 1.0) for item in (draws, refits)]
        lines.append(f"| {seed} | {len(refits)} | " + " | ".join(cells) + f" | {ks_2samp(draws, refits).pvalue:.2f} |")
        p_values += [(1.0 + sum(item >= refit for item in draws)) / (1.0 + len(draws)) for refit in refits]
    shares = ", ".join(f"{100 * np.mean(np.array(p_values) <= level):.0f} % at {100 * level:g} %" for level in LEVELS)
    return "\n".join([*lines, "", f"Of {len(p_values)} refits p is at most as stated in {shares}."]) + "\n"


def main() -> None:
    """Refit what is missing, and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--refits", type=int, default=20, help="of each experiment")
    parser.add_argument("--seeds", type=int, default=1, help="experiments")
    parser.add_argument("--folder", type=Path, default=Path("refits"))
    parser.add_argument("--shard", default="1/1", help="k/n: every n-th refit from the k-th on")
    parser.add_argument("--score", action="store_true", help="refit nothing")
    requests = parser.parse_args()
    requests.folder.mkdir(parents=True, exist_ok=True)
    own, shards = (int(item) for item in requests.shard.split("/"))
    path = requests.folder / f"refits-{own}-of-{shards}.jsonl"
    done = {(item["seed"], item["number"]) for item in _stored(requests.folder)}
    required = [(FIRST_SEED + seed, number) for number in range(-1, requests.refits) for seed in range(requests.seeds)]
    for seed, number in [] if requests.score else required[own - 1 :: shards]:
        if (seed, number) not in done:
            value = linear(seed) if number < 0 else refitted(seed, number)
            with path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps({"seed": seed, "number": number, "loudest": value}) + "\n")
    drawn, found = dict[int, list[float]](), dict[int, list[float]]()
    for item in _stored(requests.folder):
        if item["number"] < 0:
            drawn[item["seed"]] = item["loudest"]
        else:
            found.setdefault(item["seed"], []).append(item["loudest"])
    sys.stdout.write(comparison(drawn, found))


def _stored(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for path in sorted(folder.glob("refits-*.jsonl")) for line in path.read_text(encoding="utf-8").splitlines()]


if __name__ == "__main__":
    main()
