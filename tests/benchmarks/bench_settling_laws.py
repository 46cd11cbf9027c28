"""Laws of settling at the start of rows and frames: in time, in position, in pixels; one or two exponentials; and the scans that decide.

    python tests/benchmarks/bench_settling_laws.py --seeds 10 --nulls 20 --folder laws [--shard 1/2] [--seconds 3000]
    python tests/benchmarks/bench_settling_laws.py ... --folder laws --score

A calibration of 8 pairs, and the same again with half the dwell and row time, at half the pixel size, or at half the pixel size with
a quarter of the dwell and row time (both by one factor would leave the laws in time and in position equal); the simulators' own
effects at displacement level, as in `bench_decide`. A law in position is part of the distortion where only the dwell changes, and a
distortion in pixels is part of it always: then the answer is NONE.
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
from blind.observing import QUICK, observed
from blind.scoring import at_least, at_most
from numexp.world import SCAN

from semlive.data.diagnosis.effects import Outcome
from semlive.data.grid import Grid
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.two_runs.decide import compare_runs
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.settling import (
    FlybackSettling,
    FrameStartSettling,
    FrameStartSettlingInPosition,
    RowStartSettlingInPosition,
)

EDGE = Grid(56, 56, 45, 20, 17, 43)
PIXEL_UM, FIRST_SEED, AGAIN = SCAN.pixel_size_um, 60_001, 500_000
FASTER = replace(SCAN, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)
FINER = replace(SCAN, pixel_size_um=0.5 * PIXEL_UM)
BOTH = replace(SCAN, pixel_size_um=0.5 * PIXEL_UM, dwell_time_s=0.25 * SCAN.dwell_time_s, frame_time_s=0.25 * SCAN.frame_time_s)
SCANS = {"dwell": FASTER, "pixel size": FINER, "both": BOTH}
NOTHING, TWO = "nothing", "_two_terms"
EXPECTED = {
    "flyback_settling": {"dwell", "both"},
    "row_start_settling_in_position": {"pixel size", "both"},
    "frame_start_settling": {"dwell", "both"},
    "frame_start_settling_in_position": {"pixel size", "both"},
    "flyback_settling_two_terms": {"dwell", "both"},
    "row_start_settling_in_position_two_terms": {"pixel size", "both"},
}
"""Laws, and the changes of the scan that identify them; where another change does not move the settling, the answer is NONE."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """A case.

    Attributes:
        name: law of the hidden settling.
        change: what differs in the second scan.
        seed: of everything.
    """

    name: str
    change: str
    seed: int

    @property
    def key(self) -> str:
        """By which its verdict is known."""
        return f"{self.name} {self.change} {self.seed}"

    def effects(self) -> tuple[Effect, ...]:
        """1 px over 35 to 60 px (0.6 and 0.8 px over 30 to 80 rows); with two terms 0.8 px over 20 px and 0.8 px over 140 px."""
        share = (self.seed * 0.6180339887) % 1.0
        x_px, y_px = 35.0 + 25.0 * share, 30.0 + 50.0 * share
        dwell_s, row_s = SCAN.dwell_time_s, SCAN.row_time_s
        built: dict[str, Effect] = {
            "flyback_settling": FlybackSettling(1.0, x_px * dwell_s),
            "row_start_settling_in_position": RowStartSettlingInPosition(PIXEL_UM, x_px * PIXEL_UM),
            "frame_start_settling": FrameStartSettling(0.6, 0.8, y_px * row_s),
            "frame_start_settling_in_position": FrameStartSettlingInPosition(0.6 * PIXEL_UM, 0.8 * PIXEL_UM, y_px * PIXEL_UM),
            "flyback_settling_two_terms": FlybackSettling(1.5, 25.0 * dwell_s, 1.5, 180.0 * dwell_s),
            "row_start_settling_in_position_two_terms": RowStartSettlingInPosition(
                1.5 * PIXEL_UM, 25.0 * PIXEL_UM, 1.5 * PIXEL_UM, 180.0 * PIXEL_UM
            ),
        }
        return () if self.name == NOTHING else (built[self.name],)

    @property
    def answer(self) -> tuple[str, str | None]:
        """Right outcome and name."""
        moves = self.name != NOTHING and self.change in EXPECTED[self.name]
        return (Outcome.IDENTIFIED.value, self.name) if moves else (Outcome.NONE.value, None)

    def verdict(self) -> dict[str, Any]:
        """Of both runs."""
        begin = time.process_time()
        entry = observed(Conditions(self.seed, tension=0, subset_px=EDGE.subset_px), self.effects(), EDGE, QUICK)
        again = Conditions(self.seed + AGAIN, tension=0, scan=SCANS[self.change], bent_like=self.seed, subset_px=EDGE.subset_px)
        other = observed(again, self.effects(), EDGE, QUICK)
        made_s = time.process_time()
        found = compare_runs((noise_scaled_baseline(entry), noise_scaled_baseline(other)))
        took_s = time.process_time() - made_s
        return {
            "key": self.key,
            **asdict(self),
            "outcome": found.outcome.value,
            "named": None if found.effect is None else found.effect.name,
            "ambiguous": list(found.ambiguous),
            "evidence": dict(found.evidence[:4]),
            "apart": found.separate_log_odds,
            "parameters": {} if found.effect is None else {item.name: [item.value, item.sigma] for item in found.effect.parameters},
            "cpu_s": took_s,
            "all_s": time.process_time() - begin,
        }


def cases(seeds: int, nulls: int) -> Iterator[Hidden]:
    """Every law with every change for each seed; then calibrations without settling."""
    for seed in range(seeds):
        yield from (Hidden(name, change, FIRST_SEED + seed) for name in EXPECTED for change in SCANS)
    yield from (Hidden(NOTHING, change, FIRST_SEED + 1000 + seed) for seed in range(nulls) for change in SCANS)


def table(found: list[dict[str, Any]]) -> str:
    """As Markdown."""
    lines = ["| hidden law | change of the scan | right answer | right | wrong name | open |", "|---" * 6 + "|"]
    wrong_names = 0
    for name in (*EXPECTED, NOTHING):
        for change in SCANS:
            own = [entry for entry in found if (entry["name"], entry["change"]) == (name, change)]
            if not own:
                continue
            outcome, named = Hidden(name, change, 0).answer
            right = sum(entry["outcome"] == outcome and (named is None or entry["named"] == named) for entry in own)
            wrong = sum(entry["outcome"] == Outcome.IDENTIFIED.value and entry["named"] != named for entry in own)
            wrong_names += wrong
            lines.append(
                f"| `{name}` | {change} | {outcome} | {right} of {len(own)} (at least {100 * at_least(right, len(own)):.0f} %) | {wrong} "
                f"| {len(own) - right - wrong} |"
            )
    bound = 100 * at_most(wrong_names, len(found)) if found else 100.0
    return "\n".join([*lines, "", f"Wrong names: {wrong_names} of {len(found)} (bound {bound:.1f} %).", ""])


def main() -> None:
    """Run what is missing, or score what is there."""
    run(__doc__, "laws", cases, table)


if __name__ == "__main__":
    main()
