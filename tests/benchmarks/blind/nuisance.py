"""Conditions that no case of the usual sets has: what the thresholds of the diagnosis were never chosen with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from blind.experiment import Conditions
from numexp.noise import NoiseKind
from numexp.world import SCAN

from semlive.data.grid import Grid
from semlive_simulators.effects.drift import RandomWalkDrift

HALF = replace(SCAN, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)
Rng = np.random.Generator
SUBSET_PX = 43
BIAS = "bias of the correlation"
WALK_PX = 0.002, 0.01
"""Per root of a second: 0.16 to 0.8 px in 6500 s."""
SLOW_S, FAST_S = 300.0, 10.0
"""Shortest period of a walk: longer than a frame, and of 90 rows."""
SPAN_S = 20_000.0, 8_000.0
"""Time after which a slow and a fast walk are mirrored, beyond the end of a run; the number of waves is proportional to it."""


def _walking(plain: Conditions, rng: Rng) -> Conditions:
    return replace(plain, sway=(RandomWalkDrift(float(rng.uniform(*WALK_PX)), SPAN_S[0], SLOW_S, plain.seed),))


def _walking_within_frames(plain: Conditions, rng: Rng) -> Conditions:
    """A drift that walks within frames; points are means over subsets, because it displaces the rows of a subset differently."""
    walk = RandomWalkDrift(float(rng.uniform(*WALK_PX)), SPAN_S[1], FAST_S, plain.seed)
    return replace(plain, sway=(walk,), subset_px=SUBSET_PX)


NUISANCES: dict[str, Callable[[Conditions, Rng], Conditions]] = {
    "subset means": lambda plain, rng: replace(plain, subset_px=SUBSET_PX),
    "gaussian noise": lambda plain, rng: replace(plain, kind=NoiseKind.GAUSSIAN),
    "independent noise": lambda plain, rng: replace(plain, kind=NoiseKind.WHITE),
    "size of the noise": lambda plain, rng: replace(plain, noise_px=float(0.02 * 3.0 ** rng.uniform(-1.0, 1.0))),
    "wrong start times": lambda plain, rng: replace(plain, clock_sd_s=1.0),
    "random pauses": lambda plain, rng: replace(plain, pause_s=300.0),
    "lost regions": lambda plain, rng: replace(plain, lost_px=float(rng.uniform(60.0, 150.0)), missing=0.05, outliers=0.005),
    "stage errors": lambda plain, rng: replace(plain, stage_error_px=4.0),
    "walking drift": _walking,
    "walk within frames": _walking_within_frames,
    BIAS: lambda plain, rng: replace(plain, bias_px=0.001),
    "short plan": lambda plain, rng: replace(plain, calibration=6, tension=6),
    "long plan": lambda plain, rng: replace(plain, calibration=9, tension=16),
    "half the dwell": lambda plain, rng: replace(plain, scan=HALF),
    "part of the frame": lambda plain, rng: plain,
    "any size": lambda plain, rng: plain,
}
"""Conditions of a case by name; `GRIDS` has the points of those that change them."""
ANY_SIZE = "any size"
GRIDS = {"part of the frame": Grid(400, 250, 12, 40, 40, SUBSET_PX)}


def under(name: str, plain: Conditions) -> Conditions:
    """The conditions of a case under such a nuisance; none without a name."""
    return NUISANCES[name](plain, np.random.default_rng((plain.seed, 78))) if name else plain
