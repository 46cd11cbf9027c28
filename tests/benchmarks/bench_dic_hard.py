"""Wrong points that call themselves converged, counted in hard cases: ``python tests/benchmarks/bench_dic_hard.py --points 1e6``.

A point is wrong if it is off by more than max(0.5 px, 6 stated sigma). A point is matchable if its complete subset, one pixel
around included, is seen in both frames and moves as one, its texture does not repeat itself and the noise is 10 grey at most.

``--cracks`` takes other scenes: cracks in patterns that are difficult for subsets (coarse, weak, both), where ``auto`` tries the global
method; a scene takes 10 s of processor time.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from hard_scenes import Scene, cracked_scene, scene

from semlive import dic
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.settings import DicSettings

WRONG_PX = 0.5
WRONG_SIGMAS = 6.0
SETTINGS = DicSettings(step_px=5, roi_px=None)


@dataclass
class Count:
    """What became of the points of one case.

    Attributes:
        points: all of them.
        converged: called converged.
        wrong: of these, too far off.
        worst_px: largest error of a converged point.
        matchable: that ought to converge.
        matched: of these, converged.
        repeating: whose texture repeats itself within the subset and around.
        ambiguous: of these, reported so.
    """

    points: int = 0
    converged: int = 0
    wrong: int = 0
    worst_px: float = 0.0
    matchable: int = 0
    matched: int = 0
    repeating: int = 0
    ambiguous: int = 0


def all_around(pixels: NDArray[np.bool_], half: int) -> NDArray[np.bool_]:
    """Where a complete window of pixels is True."""
    kernel = np.ones((2 * half + 1, 2 * half + 1), np.uint8)
    return cv2.erode(pixels.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0).astype(bool)


def correlate(s: Scene, settings: DicSettings = SETTINGS) -> DisparityMap:
    """The map of a scene."""
    height, width = s.first.shape
    reference = dic.prepare(s.first, dic.grid_for(settings, width, height), settings)
    return dic.correlate(reference, s.second, settings, reference_frame=0, current_frame=1)


@dataclass(frozen=True)
class Verdict:
    """(ny, nx) maps of what is true of a scene's points and what became of them."""

    error_px: NDArray
    wrong: NDArray[np.bool_]
    matchable: NDArray[np.bool_]
    repeating: NDArray[np.bool_]


def judge(s: Scene, m: DisparityMap) -> Verdict:
    """Compare a map with the truth."""
    half = m.grid.subset_px // 2
    x, y = (a.astype(int) for a in m.grid.mesh())
    error = np.where(m.valid & s.judged[y, x], np.hypot(m.u_px - s.u[y, x], m.v_px - s.v[y, x]), 0.0)
    sigma = np.maximum(m.sigma_u_px, m.sigma_v_px)
    plain = all_around(s.plain, half + 2)[y, x]
    return Verdict(
        error_px=error,
        wrong=error > np.maximum(WRONG_PX, WRONG_SIGMAS * sigma),
        matchable=plain & all_around(s.unique, half + 2)[y, x] & (s.noise <= 10.0),
        repeating=plain & all_around(~s.unique, half + 2)[y, x],
    )


def campaign(
    points: int, first: int = 0, settings: DicSettings = SETTINGS, scenes: Callable[[int], Scene] = scene
) -> Iterator[tuple[Scene, DisparityMap, Verdict]]:
    """Scenes until so many points were tried."""
    number = first
    while points > 0:
        s = scenes(number)
        m = correlate(s, settings)
        yield s, m, judge(s, m)
        points -= m.status.size
        number += 1


def tally(points: int, first: int = 0, settings: DicSettings = SETTINGS, scenes: Callable[[int], Scene] = scene) -> dict[str, Count]:
    """Counts by case."""
    counts: dict[str, Count] = defaultdict(Count)
    for s, m, verdict in campaign(points, first, settings, scenes):
        c = counts[s.name]
        c.points += m.status.size
        c.converged += int(m.valid.sum())
        c.wrong += int(verdict.wrong.sum())
        c.worst_px = max(c.worst_px, float(verdict.error_px.max()))
        c.matchable += int(verdict.matchable.sum())
        c.matched += int((verdict.matchable & m.valid).sum())
        c.repeating += int(verdict.repeating.sum())
        c.ambiguous += int((verdict.repeating & (m.status == PoiStatus.AMBIGUOUS)).sum())
    return counts


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=float, default=1e6)
    parser.add_argument("--first", type=int, default=0, help="number of the first scene; from another one on all scenes are others")
    parser.add_argument("--subset", type=int, default=SETTINGS.subset_px)
    parser.add_argument("--shape", choices=("affine", "quadratic", "quartic"), default="affine")
    parser.add_argument("--cracks", action="store_true", help="cracks in difficult patterns instead of the eight cases")
    given = parser.parse_args()
    settings = DicSettings(subset_px=given.subset, step_px=SETTINGS.step_px, roi_px=None, shape_function=given.shape)
    counts = tally(int(given.points), given.first, settings, cracked_scene if given.cracks else scene)
    sys.stdout.write(f"{'case':24}{'points':>9}{'converged':>11}{'wrong':>7}{'worst px':>10}{'matchable':>11}{'converged':>11}{'%':>8}\n")
    for name, c in sorted(counts.items()):
        part = f"{100 * c.matched / c.matchable:8.2f}" if c.matchable else "       -"
        line = f"{name:24}{c.points:9}{c.converged:11}{c.wrong:7}{c.worst_px:10.3f}{c.matchable:11}{c.matched:11}{part}"
        sys.stdout.write(line + (f"   repeating {c.repeating}, marked as such {c.ambiguous}\n" if c.repeating else "\n"))
    total = Count(*(sum(getattr(c, f) for c in counts.values()) for f in Count.__dataclass_fields__))
    share = 100 * total.matched / max(total.matchable, 1)
    sys.stdout.write(f"all: {total.points} points, {total.wrong} wrong, {share:.2f} % of {total.matchable} matchable converged\n")


if __name__ == "__main__":
    main()
