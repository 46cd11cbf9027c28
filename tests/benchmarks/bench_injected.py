"""A small strain injected into runs with a hidden effect: its share that remains after the effect was identified and corrected.

    python tests/benchmarks/bench_injected.py --seeds 2 --folder injected [--shard 1/2] [--seconds 3000]
    python tests/benchmarks/bench_injected.py ... --folder injected --score [--write]

Two runs with the same drift, distortion, stage errors, noise and effect, the simulators' own at four times what can be detected, at
displacement level; in one the specimen is strained by 1e-4 along y more in every pair under load. Each run passes independently through the
programs, as a user's would: `semlive import`, `semlive diagnose -o MODEL`, `semlive replay --model MODEL`. How much more the mean strain of
the pairs under load is in one than in the other, in parts of 1e-4, is what survives; replayed without a model, what the estimate itself
keeps. An interrupted run continues where it stopped; shards write into one folder.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from blind.campaign import run
from blind.cases import GRID, ONE, Case
from blind.experiment import Conditions
from blind.hiding import DETECTABLE_PX
from blind.imported import imported
from blind.scoring import at_least

INJECTED, SIZE, FIRST_SEED, MAX_STRAIN_ERROR = 1e-4, 4.0, 90_001, 0.02
STRAIN_LIKE = "is strain or cannot be separated from it"


@dataclass(frozen=True, slots=True)
class Injected:
    """A case.

    Attributes:
        name: of what is hidden.
        seed: of everything.
    """

    name: str
    seed: int

    @property
    def key(self) -> str:
        """By which its verdict is known."""
        return f"{self.name} {self.seed}"

    def verdict(self) -> dict[str, Any]:
        """Of both runs, and what survives."""
        case = Case(ONE, (self.name,), SIZE, self.seed)
        with tempfile.TemporaryDirectory() as name:
            without, with_effects = (
                results(Path(name) / word, replace(case.conditions(), injected=strain), case)
                for word, strain in (("without", 0.0), ("having", INJECTED))
            )
        return {
            "key": self.key,
            **asdict(self),
            "names": [without["names"], with_effects["names"]],
            "outcomes": [without["outcome"], with_effects["outcome"]],
            "left_in": [without["left_in"], with_effects["left_in"]],
            "survives": (with_effects["strain"] - without["strain"]) / INJECTED,
            "by_itself": (with_effects["uncorrected"] - without["uncorrected"]) / INJECTED,
        }


def results(folder: Path, conditions: Conditions, case: Case) -> dict[str, Any]:
    """Results of the programs for one run."""
    log, model = imported(folder, conditions, case.effects(), GRID), folder.with_suffix(".json")
    found = _semlive("diagnose", str(log), "-o", str(model), "--json")
    plain = _semlive("replay", str(log), "--json")
    corrected = _semlive("replay", str(log), "--model", str(model), "--json") if model.exists() else plain
    return {
        "outcome": found["outcome"],
        "names": [item["name"] for item in found["effects"]],
        "left_in": any(STRAIN_LIKE in item for item in corrected["warnings"]),
        "uncorrected": _strain(plain),
        "strain": _strain(corrected),
    }


def _semlive(*arguments: str) -> dict[str, Any]:
    done = subprocess.run([sys.executable, "-m", "semlive", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"semlive {' '.join(arguments)}: {done.stderr}")
    return dict(json.loads(done.stdout))


def _strain(result: dict[str, Any]) -> float:
    """Mean along y of all frames under load."""
    return float(np.mean([item["strain_mean"]["eyy"] for item in result["frames"] if item["phase"] == "tension"]))


def cases(seeds: int, nulls: int) -> Iterator[Injected]:
    """Each effect by each seed; where nothing is hidden nothing is corrected."""
    for seed in range(seeds):
        yield from (Injected(name, FIRST_SEED + seed) for name in DETECTABLE_PX)


def table(found: list[dict[str, Any]]) -> str:
    """As Markdown."""
    lines = ["| hidden effect | same effect in both | not corrected, strain-like | retained strain |", "|---" * 4 + "|"]
    for name in DETECTABLE_PX:
        own = [item for item in found if item["name"] == name]
        equal = sum(item["names"][0] == item["names"][1] == [name] for item in own)
        strain_like = sum(any(item["left_in"]) for item in own)
        shares = ", ".join(f"{100 * item['survives']:.2f} %" for item in own)
        if own:
            lines.append(f"| `{name}` | {equal} of {len(own)} | {strain_like} | {shares} |")
    if not found:
        return "\n".join(lines) + "\n"
    stored = sum(abs(item["survives"] - 1.0) <= MAX_STRAIN_ERROR for item in found)
    worst, itself = (max(abs(item[what] - 1.0) for item in found) for what in ("survives", "by_itself"))
    lines.append(
        f"\nWithin {100 * MAX_STRAIN_ERROR:g} % in {stored} of {len(found)} cases (at least {100 * at_least(stored, len(found)):.1f} %),"
        f" largest error {100 * worst:.2f} %; without any model at most {100 * itself:.2f} %."
    )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run what is missing, or score what is there."""
    run(__doc__, "injected", cases, table)


if __name__ == "__main__":
    main()
