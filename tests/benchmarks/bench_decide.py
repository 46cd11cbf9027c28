"""Effects that one run cannot separate from the distortion, and two runs with different scans can.

    python tests/benchmarks/bench_decide.py --seeds 35 --nulls 300 --folder decided [--shard 1/2] [--seconds 3000]
    python tests/benchmarks/bench_decide.py ... --folder decided --score [--write]

An experiment of 15 pairs, and the calibration again with half the dwell and half the row time: another drift, other stage errors, other
noise, the same distortion and the same effect, the simulators' own, at displacement level (means over subsets of 43 px, 0.02 px of noise
shared over them, 1 % of the points missing, 0.1 % wrong). Of ten seeds the first run alone is diagnosed too: of what is the same in all of
its frames it must name nothing. An interrupted run continues where it stopped; shards write into one folder.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from blind.campaign import run
from blind.experiment import Conditions
from blind.observing import observed
from blind.scoring import at_least, at_most
from numexp.world import SCAN

from semlive.data.grid import Grid
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.maps.verdict import diagnose
from semlive.diagnose.two_runs.decide import compare_runs
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.library import LIBRARY

EDGE = Grid(56, 56, 15, 60, 50, 43)
"""As close to the edges as subsets and moves allow."""
HALF = replace(SCAN, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)
FIRST_SEED, AGAIN, NOTHING, ALONE = 40_001, 500_000, "nothing", 10
SIZES = {
    "flyback_settling": (0.2, 0.5),
    "frame_start_settling": (0.3, 0.6),
    "line_sync_hum": (0.005, 0.02),
    "wrong_row_time": (0.2, 0.4),
}
"""px, of the row time a share."""
TRUTH = {"flyback_settling": "amplitude_px", "frame_start_settling": "y_px", "wrong_row_time": "row_time_error"}


@dataclass(frozen=True, slots=True)
class Hidden:
    """A case.

    Attributes:
        name: of what is hidden.
        size: px, or a share of the row time.
        seed: of everything.
    """

    name: str
    size: float
    seed: int

    @property
    def key(self) -> str:
        """By which its verdict is known."""
        return f"{self.name} {self.size:g} {self.seed}"

    def effects(self) -> tuple[Effect, ...]:
        """What is hidden: beams that settle within 25 to 60 columns, or within 3 to 8 s."""
        share = (self.seed * 0.6180339887) % 1.0
        if self.name == NOTHING:
            return ()
        built: dict[str, tuple[float, ...]] = {
            "flyback_settling": (self.size, 2.5e-3 + 3.5e-3 * share),
            "frame_start_settling": (0.6 * self.size, 0.8 * self.size, 3.0 + 5.0 * share),
            "line_sync_hum": (self.size, 50.0),
            "wrong_row_time": (self.size,),
        }
        kind: Any = LIBRARY[self.name]
        return (kind(*built[self.name]),)

    def verdict(self) -> dict[str, Any]:
        """Of the first run alone, and of both."""
        begin = time.process_time()
        entry = observed(Conditions(self.seed, subset_px=EDGE.subset_px), self.effects(), EDGE)
        again = Conditions(self.seed + AGAIN, tension=0, scan=HALF, bent_like=self.seed, subset_px=EDGE.subset_px)
        other = observed(again, self.effects(), EDGE)
        made_s = time.process_time()
        found = compare_runs((noise_scaled_baseline(entry), noise_scaled_baseline(other)))
        took_s = time.process_time() - made_s
        alone = diagnose(entry) if self.name != NOTHING and self.seed < FIRST_SEED + ALONE else None
        reported = {} if found.effect is None else {item.name: [item.value, item.sigma] for item in found.effect.parameters}
        return {
            "key": self.key,
            **asdict(self),
            "alone": None if alone is None else alone.outcome.value,
            "alone_names": [] if alone is None else [item.name for item in alone.effects],
            "outcome": found.outcome.value,
            "named": None if found.effect is None else found.effect.name,
            "ambiguous": list(found.ambiguous),
            "evidence": dict(found.evidence[:4]),
            "apart": found.separate_log_odds,
            "parameters": reported,
            "cpu_s": took_s,
            "all_s": time.process_time() - begin,
        }


def cases(seeds: int, nulls: int) -> Iterator[Hidden]:
    """In an order in which each part of the list holds cases of every kind."""
    for seed in range(max(seeds, 1)):
        for name, sizes in SIZES.items() if seed < seeds else ():
            yield from (Hidden(name, size, FIRST_SEED + seed) for size in sizes)
        each = -(-nulls // max(seeds, 1))
        yield from (Hidden(NOTHING, 0.0, FIRST_SEED + 1000 + null) for null in range(seed * each, min((seed + 1) * each, nulls)))


def table(found: list[dict[str, Any]]) -> str:
    """As Markdown."""
    lines = [
        "| hidden effect | two runs: correct | wrong effect | first run alone | error, median | inside stated 90 % |",
        "|---" * 6 + "|",
    ]
    for name, sizes in SIZES.items():
        for size in sizes:
            own = [entry for entry in found if entry["name"] == name and entry["size"] == size]
            if not own:
                continue
            right = [entry for entry in own if entry["outcome"] == "IDENTIFIED" and entry["named"] == name]
            wrong = sum(entry["outcome"] == "IDENTIFIED" and entry["named"] != name for entry in own)
            alone = [entry for entry in own if entry["alone"]]
            named = sum(entry["alone"] == "IDENTIFIED" for entry in alone)
            rightly = sum(entry["alone"] == "IDENTIFIED" and entry["alone_names"] == [name] for entry in alone)
            unit = "" if name == "wrong_row_time" else " px"
            lines.append(
                f"| `{name}`, {size:g}{unit} | {len(right)} of {len(own)} (at least {100 * at_least(len(right), len(own)):.0f} %) | {wrong}"
                f" | {rightly} correct, {named - rightly} wrong, of {len(alone)} | {_errors(name, size, right)} |"
            )
    nulls = [entry for entry in found if entry["name"] == NOTHING]
    if nulls:
        named = sum(entry["outcome"] in ("IDENTIFIED", "AMBIGUOUS") for entry in nulls)
        unknown = sum(entry["outcome"] == "UNKNOWN" for entry in nulls)
        loudest = max(max(entry["evidence"].values()) for entry in nulls)
        lines.append(
            f"\nWithout a hidden effect {named} of {len(nulls)} were IDENTIFIED or AMBIGUOUS"
            f" (bound {100 * at_most(named, len(nulls)):.1f} %),\n{unknown} UNKNOWN;"
            f" the largest ln B was {loudest:.1f}, the threshold is 7."
        )
    return "\n".join(lines) + "\n"


def _errors(name: str, size: float, right: list[dict[str, Any]]) -> str:
    own = TRUTH.get(name)
    if own is None or not right:
        return " | "
    true = 0.8 * size if own == "y_px" else size
    reported = [entry["parameters"][own] for entry in right]
    off = sorted(abs(value - true) / true for value, _ in reported)
    inside = sum(abs(value - true) < 1.645 * sigma for value, sigma in reported)
    return f"{100 * off[len(off) // 2]:.0f} % | {inside} of {len(reported)}"


def main() -> None:
    """Run what is missing, or score what is there."""
    run(__doc__, "decided", cases, table)


if __name__ == "__main__":
    main()
