"""A world of point disparities, written apart from the estimator: other drift and distortion functions, other solution, no splines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced

WIDTH_PX, HEIGHT_PX = 1024, 884
DWELL_S, FRAME_S = 1e-4, 94.67
ROW_S = FRAME_S / HEIGHT_PX
FRAMES_PER_STEP = 4  # two are taken, two go by while specimen and stage move and rest
SMOOTH_PX = 12.0  # smoothing of white noise that gives the correlation area of a 43 px subset
Field = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    phase: Phase
    shift_px: tuple[float, float]
    strain: float


@dataclass(frozen=True)
class Taken:
    """One pair: what the estimator is given, and what it must not see."""

    pair: int
    step: Step
    times: tuple[FrameTime, FrameTime]
    maps: tuple[DisparityMap, ...]
    gradient: Field
    correction_px: dict[int, Field]

    def worst_px(self, correction: Callable[[DisparityMap], Any]) -> float:
        """Largest rms error of a correction of the maps from frame 0, its mean removed."""
        worst = 0.0
        for dmap in self.maps[1:]:
            found = correction(dmap)
            error = np.stack((found.u_px, found.v_px), axis=-1) - self.correction_px[dmap.current]
            worst = max(worst, float(np.sqrt(np.mean((error - error.mean(axis=(0, 1))) ** 2))))
        return worst


@dataclass
class World:
    seed: int
    grid: Grid
    noise_px: float = 0.02
    rng: np.random.Generator = field(init=False)
    noise: dict[int, Field] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.wave = self.rng.uniform(0, 2 * np.pi, 4)
        self.bend = self.rng.uniform(-0.7, 0.7, 6)
        self.warm_px = self.rng.uniform(4, 8, 2) * self.rng.choice([-1, 1], 2)
        self.warm_s = self.rng.uniform(1200, 2500)
        self.rate_px_s, self.bend_px_s2 = self.rng.uniform(-6e-4, 6e-4, 2), self.rng.uniform(-1e-7, 1e-7, 2)

    def drift(self, time_s: Field) -> Field:
        t = np.asarray(time_s)[..., None]
        return self.warm_px * (1 - np.exp(-t / self.warm_s)) + self.rate_px_s * t + self.bend_px_s2 * t**2

    def distortion(self, at: Field) -> Field:
        x, y = at[..., 0], at[..., 1]
        a, b = (x - 511.5) / 512, (y - 441.5) / 442
        tau, q, w = 2 * np.pi, self.bend, self.wave
        ex = 0.4 * np.cos(tau * x / 700 + w[0]) * np.cos(tau * y / 900 + w[1]) + q[0] * a * a + q[1] * a * b + q[2] * b * b
        ey = 0.4 * np.cos(tau * x / 800 + w[2]) * np.cos(tau * y / 650 + w[3]) + q[3] * a * a + q[4] * a * b + q[5] * b * b
        return np.stack((ex, ey), axis=-1)

    def error(self, at: Field, start_s: float) -> Field:
        """Drift and distortion of what the beam meets at scan addresses."""
        return self.distortion(at) + self.drift(start_s + at[..., 0] * DWELL_S + at[..., 1] * ROW_S)

    def address(self, ideal: Field, start_s: float) -> Field:
        at = ideal
        for _ in range(12):
            at = ideal + self.error(at, start_s)
        return at

    def noise_at(self, frame: int, at: Field) -> Field:
        """Noise of one frame, sqrt(1/2) of a map's, correlated as overlapping subsets are."""
        if frame not in self.noise:
            smooth = SMOOTH_PX / 5
            white = self.rng.normal(size=(2, HEIGHT_PX // 5 + 20, WIDTH_PX // 5 + 20))
            amplitude = self.noise_px / np.sqrt(2) * 2 * np.sqrt(np.pi) * smooth
            self.noise[frame] = amplitude * np.stack([gaussian_filter(item, smooth, mode="wrap") for item in white])
        where = np.stack((at[..., 1] / 5 + 10, at[..., 0] / 5 + 10))
        return np.stack([map_coordinates(item, where, order=1, mode="nearest") for item in self.noise[frame]], axis=-1)

    def map(self, reference: int, current: int, before: Field, after: Field) -> DisparityMap:
        moved = after - before + self.noise_at(current, after) - self.noise_at(reference, before)
        u, v, item = moved[..., 0].copy(), moved[..., 1].copy(), np.ones(self.grid.shape)
        return DisparityMap(reference, current, self.grid, u, v, 0.02 * item, 0.02 * item, item, np.zeros(self.grid.shape, np.uint8))

    def pairs(self, steps: list[Step], starts_s: list[float] | None = None) -> Iterator[Taken]:
        """Pairs one after the other, or at times of their own."""
        here = np.stack(self.grid.mesh(), axis=-1)
        centre = np.array([WIDTH_PX - 1, HEIGHT_PX - 1]) / 2
        ideal = here - self.error(here, 0.0)
        for pair, step in enumerate(steps):
            start_s = pair * FRAMES_PER_STEP * FRAME_S if starts_s is None else starts_s[pair]
            yaw = self.rng.normal(0, 2e-4) if pair and step.phase is not Phase.TENSION else 0.0
            gradient = np.array([[-0.33 * step.strain, -yaw], [yaw, step.strain]])
            shift = np.array(step.shift_px) + (self.rng.normal(0, 0.8, 2) if pair else 0.0)
            moved = ideal + shift + (ideal - centre) @ gradient.T
            first, second = self.address(moved, start_s), self.address(moved, start_s + FRAME_S)
            again = self.address(here - self.error(here, start_s), start_s + FRAME_S)
            n = 2 * pair
            maps = (self.map(n, n + 1, here, again),)
            if pair:
                maps += (self.map(0, n, here, first), self.map(0, n + 1, here, second))
            truth = {n + i: at - here - (moved - ideal) for i, at in enumerate((first, second))}
            times = (FrameTime(n, start_s, timing()), FrameTime(n + 1, start_s + FRAME_S, timing()))
            yield Taken(pair, step, times, maps, gradient, truth)


def timing() -> ScanTiming:
    def sourced(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    return ScanTiming(sourced(DWELL_S), sourced(ROW_S), sourced(FRAME_S), Sourced(1, Provenance.CONFIG))


def full_plan() -> list[Step]:
    """13 calibration pairs in a cross, 2 translations, 7 tensile steps."""
    arm = [(8.0, 0.0), (16.0, 0.0), (32.0, 0.0), (-8.0, 0.0), (-16.0, 0.0), (-32.0, 0.0)]
    cross = [(0.0, 0.0), *arm, *((y, x) for x, y in arm)]
    moves = [Step(Phase.CALIBRATION, shift, 0.0) for shift in cross]
    moves += [Step(Phase.TRANSLATION, shift, 0.0) for shift in ((6.0, -4.0), (-5.0, 7.0))]
    return moves + tension(7)


def short_plan() -> list[Step]:
    """5 calibration pairs in both axes, 4 tensile steps."""
    cross = [(0.0, 0.0), (24.0, 0.0), (-24.0, 0.0), (0.0, 24.0), (0.0, -24.0)]
    return [Step(Phase.CALIBRATION, shift, 0.0) for shift in cross] + tension(4)


def tension(steps: int) -> list[Step]:
    return [Step(Phase.TENSION, (1.5 * i, -2.0 * i), 3.1e-3 * i / (steps - 1)) for i in range(steps)]


@pytest.fixture(scope="session")
def plans() -> dict[str, list[Step]]:
    return {"full": full_plan(), "short": short_plan()}


@pytest.fixture(scope="session")
def world() -> Callable[..., World]:
    """``world(seed, step_px, noise_px)``: a world seen on the paper's area, every `step_px`."""

    def make(seed: int, step_px: int = 15, noise_px: float = 0.02) -> World:
        grid = Grid(101, 101, step_px, 1 + 745 // step_px, 1 + 595 // step_px, 43)
        return World(seed, grid, noise_px)

    return make
