"""Comparison of two runs of which the second's scan was turned: the scan's axes and ramps, or the column's lens.

    python tests/benchmarks/bench_turned.py --seeds 40 --nulls 300 --folder turned [--shard 1/2] [--seconds 3000]
    python tests/benchmarks/bench_turned.py ... --folder turned --score [--write]

The calibration that `semlive experiment propose --kind turned_scan` asks for, and the same with the scan turned by 90 degrees (give or
take 0.3): another drift, other stage errors of 0.3 px, a backlash of 0.64 px, other noise (0.02 px, shared over subsets, 1 % of the points
missing, 0.1 % wrong); effects are the simulators' own, at displacement level. The distortion stays with the column unless the case states
otherwise. An interrupted run continues where it stopped; shards write into one folder.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from blind.campaign import run
from blind.experiment import CROSS_PX, Conditions, world_of
from blind.observing import observed
from blind.scoring import at_least, at_most
from numexp.world import HEIGHT_PX, SCAN, WIDTH_PX

from semlive.data.grid import Grid
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.experiments.protocols import SQUARE_HALF_WIDTH_PX, square_px
from semlive.diagnose.two_runs.decide import compare_runs
from semlive_simulators.effects.image_field import AnisotropicPixel, ScanNonorthogonality
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.scan_deflection import ScanNonlinearity
from semlive_simulators.effects.specimen_motion import StageBacklash

MAP_GRID = Grid(200, 200, 24, 26, 21, 43)
"""What moves of 150 px and 20 px of drift leave in view."""
MOVES_PX = tuple((x, y) for x, y in square_px(SQUARE_HALF_WIDTH_PX))
BACKLASH = StageBacklash(0.4)
FIRST_SEED, AGAIN, STAGE_PX, TURN_RAD = 60_001, 500_000, 0.3, 0.005
PIXEL, SKEW, RAMPS = "anisotropic_pixel", "scan_nonorthogonality", "scan_nonlinearity"
DISC_PX = 365.0


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of case.

    Attributes:
        about: what is hidden, as the table has it.
        names: that are right.
        of_axes: x_excess and skew.
        of_ramps: share of the simulators' defaults at x200.
        with_scan: whether the complete distortion is the scan's.
        another: whether the second run has another distortion.
        small: whether moves are those of the published calibration, at most 32 px, of 15 pairs.
    """

    about: str
    names: tuple[str, ...]
    of_axes: tuple[float, float] = (0.0, 0.0)
    of_ramps: float = 0.0
    with_scan: bool = False
    another: bool = False
    small: bool = False


KINDS = {
    "pixel": Kind(f"`{PIXEL}`, 1 %", (PIXEL,), (0.01, 0.0)),
    "skew": Kind(f"`{SKEW}`, 10 mrad", (SKEW,), (0.0, 0.01)),
    "axes": Kind("both", (PIXEL, SKEW), (0.01, 0.01)),
    "ramps": Kind(f"`{RAMPS}`, 0.6 and 0.4 px", (RAMPS,), of_ramps=1.0),
    "scan": Kind(f"`{RAMPS}`, the complete distortion", (RAMPS,), with_scan=True),
    "pixel/4": Kind(f"`{PIXEL}`, 0.25 %", (PIXEL,), (0.0025, 0.0)),
    "skew/4": Kind(f"`{SKEW}`, 2.5 mrad", (SKEW,), (0.0, 0.0025)),
    "ramps/4": Kind(f"`{RAMPS}`, 0.15 and 0.1 px", (RAMPS,), of_ramps=0.25),
    "small": Kind(f"`{PIXEL}`, 1 %, moves of 32 px", (PIXEL,), (0.01, 0.0), small=True),
    "another": Kind("another distortion in the second run", (), another=True),
    "nothing": Kind("nothing", ()),
}
USUAL = ("pixel", "skew", "axes", "ramps", "scan")


@dataclass(frozen=True, slots=True)
class Hidden:
    """A case.

    Attributes:
        kind: of it.
        seed: of everything.
    """

    kind: str
    seed: int

    @property
    def key(self) -> str:
        """By which its verdict is known."""
        return f"{self.kind} {self.seed}"

    @property
    def sign(self) -> float:
        """Of what is hidden."""
        return -1.0 if self.seed % 2 else 1.0

    def effects(self) -> tuple[Effect, ...]:
        """What is hidden, and the backlash that every stage has."""
        kind, found = KINDS[self.kind], list[Effect]()
        e, skew = kind.of_axes
        found += [AnisotropicPixel(self.sign * e)] if e else []
        found += [ScanNonorthogonality(self.sign * skew)] if skew else []
        whole, share = ScanNonlinearity.defaults("x200"), self.sign * kind.of_ramps
        found += [ScanNonlinearity(share * whole.quadratic_px, share * whole.cubic_px, share * whole.hysteresis_px)] if share else []
        return (BACKLASH, *found)

    def conditions(self) -> tuple[Conditions, Conditions]:
        """Of the first run, and of that whose scan is turned."""
        kind = KINDS[self.kind]
        moves = CROSS_PX if kind.small else MOVES_PX
        first = Conditions(
            self.seed, len(moves), 0, moves_px=moves, stage_error_px=STAGE_PX, of_column=not kind.with_scan,
        )  # fmt: skip
        share = 2.0 * ((self.seed * 0.6180339887) % 1.0) - 1.0
        scan = replace(SCAN, rotation_rad=0.5 * math.pi + TURN_RAD * share)
        return first, replace(first, seed=self.seed + AGAIN, scan=scan, bent_like=None if kind.another else self.seed)

    def axes(self) -> tuple[float, float]:
        """True x_excess and skew: those of a distortion that is the scan's own count too."""
        kind = KINDS[self.kind]
        e, skew = (self.sign * one for one in kind.of_axes)
        if kind.with_scan:
            slope = self._slope()
            e, skew = e + slope[0, 0] - slope[1, 1], skew + slope[0, 1] + slope[1, 0]
        return e, skew

    def _slope(self) -> np.ndarray:
        """(2, 2) best affine map of the distortion on the disc on which runs are compared."""
        x, y = np.meshgrid(*(np.linspace(-DISC_PX, DISC_PX, 101),) * 2)
        inside = np.hypot(x, y) <= DISC_PX
        at = np.stack((x[inside], y[inside]), axis=-1)
        pixel = at + 0.5 * np.array([WIDTH_PX - 1, HEIGHT_PX - 1])
        bent = world_of(self.conditions()[0]).distortion.at(pixel[:, 0], pixel[:, 1], WIDTH_PX, HEIGHT_PX)
        return np.linalg.lstsq(np.column_stack((np.ones(len(at)), at)), bent, rcond=None)[0][1:].T

    def verdict(self) -> dict[str, Any]:
        """Of both runs."""
        begin = time.process_time()
        runs = [noise_scaled_baseline(observed(one, self.effects(), MAP_GRID)) for one in self.conditions()]
        made_s = time.process_time()
        found = compare_runs(runs)
        took_s = time.process_time() - made_s
        axes, (e, skew) = found.turned, self.axes()
        assert axes is not None, f"{self.key}: the turn was not seen"
        return {
            "key": self.key,
            **asdict(self),
            "outcome": found.outcome.value,
            "named": [one.name for one in found.effects],
            "evidence": dict(found.evidence),
            "apart": found.separate_log_odds,
            "follows": axes.follows,
            "turn_off_rad": [axes.angle_rad.value - self.conditions()[1].scan.rotation_rad, axes.angle_rad.sigma],
            "x_excess": [axes.x_excess.value, axes.x_excess.sigma, e],
            "skew": [axes.skew.value, axes.skew.sigma, skew],
            "parameters": {item.name: [item.value, item.sigma] for one in found.effects for item in one.parameters},
            "cpu_s": took_s,
            "all_s": time.process_time() - begin,
        }


def cases(seeds: int, nulls: int) -> Iterator[Hidden]:
    """In an order in which each part of the list holds cases of every kind."""
    for seed in range(max(seeds, 1)):
        yield from (Hidden(kind, FIRST_SEED + seed) for kind in KINDS if kind != "nothing" and seed < seeds)
        each = -(-nulls // max(seeds, 1))
        yield from (Hidden("nothing", FIRST_SEED + 1000 + null) for null in range(seed * each, min((seed + 1) * each, nulls)))


def false_names(one: dict[str, Any]) -> list[str]:
    """Names that are not hidden; where the distortion is the scan's, axes are wrong if they are not those that it has."""
    kind = KINDS[one["kind"]]
    wrong = [name for name in one["named"] if name not in kind.names]
    if not kind.with_scan:
        return wrong
    reported = {PIXEL: one["x_excess"], SKEW: one["skew"]}
    return [name for name in wrong if abs(reported[name][0] - reported[name][2]) > 3.0 * reported[name][1]]


def table(found: list[dict[str, Any]]) -> str:
    """As Markdown."""
    head = "| hidden effect | all found | a false effect | distortion assigned correctly | axes: sigma, median | inside stated 90 % |"
    lines = [head, "|---" * 6 + "|"]
    for name, kind in KINDS.items():
        own = [one for one in found if one["kind"] == name]
        if not own:
            continue
        place = {True: "scan", False: "both" if kind.of_ramps else "neither" if kind.another else "column"}[kind.with_scan]
        right = sum(set(kind.names) <= set(one["named"]) for one in own)
        wrong = sum(bool(false_names(one)) for one in own)
        reported = f"{right} of {len(own)} (at least {100 * at_least(right, len(own)):.0f} %)" if kind.names else ""
        axes = [one[axis] for one in own for axis in ("x_excess", "skew")]
        sigma = sorted(one[1] for one in axes)[len(axes) // 2]
        within = sum(abs(value - true) < 1.645 * sigma for value, sigma, true in axes)
        inside = "" if kind.another else f"{within} of {len(axes)}"
        at = sum(one["follows"] == place for one in own)
        lines.append(f"| {kind.about} | {reported} | {wrong} | {at} of {len(own)}: {place} | {100 * sigma:.3f} % | {inside} |")
    return "\n".join(lines) + "\n" + _usual(found) + _nulls([one for one in found if one["kind"] == "nothing"])


def _usual(found: list[dict[str, Any]]) -> str:
    own = [one for one in found if one["kind"] in USUAL]
    right = sum(set(KINDS[one["kind"]].names) <= set(one["named"]) and not false_names(one) for one in own)
    wrong = sum(bool(false_names(one)) for one in found)
    return (
        f"\nFirst five rows: {right} of {len(own)} had all effects and no false one (at least {100 * at_least(right, len(own)):.1f} %);\n"
        f"all cases: {wrong} of {len(found)} had a false one (at most {100 * at_most(wrong, len(found)):.1f} %).\n"
    )


def _nulls(nulls: list[dict[str, Any]]) -> str:
    if not nulls:
        return ""
    named, unknown = sum(bool(one["named"]) for one in nulls), sum(one["outcome"] == "UNKNOWN" for one in nulls)
    loudest = max(max(one["evidence"].values()) for one in nulls)
    return (
        f"\nWithout a hidden effect {named} of {len(nulls)} had a false effect (at most {100 * at_most(named, len(nulls)):.1f} %),\n"
        f"{unknown} were UNKNOWN; the largest ln B was {loudest:.1f}, the threshold is 7.\n"
    )


def main() -> None:
    """Run what is missing, or score what is there."""
    run(__doc__, "turned", cases, table)


if __name__ == "__main__":
    main()
