"""Disparity maps of the paper's numerical experiment (Sutton 2007, Figs. 4-7), made directly, without images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numexp.cases import Case, Setting
from numexp.noise import FrameNoise
from numexp.world import HEIGHT_PX, PAUSE_S, SCAN, WIDTH_PX, Field, World, lying, make_world, start_s

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.specimen.specimen import Motion

GRID = Grid(101, 101, 5, 150, 120, 43)
ARM_PX = (8.0, -16.0, 24.0, -32.0, 16.0, -8.0, 32.0)
CROSS_PX = ((0.0, 0.0), *(shift for arm in ARM_PX for shift in ((arm, 0.0), (0.0, -arm))))
STAGE_ERROR_PX = 0.8  # the paper's translations were neither exact nor orthogonal (Fig. 15)
TOP_STRAIN, POISSON = 3e-3, 0.33


@dataclass(frozen=True, slots=True)
class ObservedFrame:
    """One frame: where it truly shows the points that frame 0 shows on the grid.

    Attributes:
        exact: the map from frame 0 without noise.
        displacement_px: (ny, nx, 2) true displacement of the material on the grid of frame 0.
        gradient: (2, 2) true displacement gradient.
    """

    exact: DisparityMap
    displacement_px: Field
    gradient: Field


@dataclass(frozen=True, slots=True)
class Taken:
    """One pair: what the estimator is given, and what it must not use (`observed`).

    Attributes:
        pair: its number.
        phase: what it is for.
        times: of its frames.
        maps: noisy, as the pipeline correlates them: within the pair, and from frame 0 to each frame.
        observed: the truth of the frames that have a map from frame 0.
        shift_px: (2,) true motion of the specimen's centre from pair 0.
    """

    pair: int
    phase: Phase
    times: tuple[FrameTime, FrameTime]
    maps: tuple[DisparityMap, ...]
    observed: tuple[ObservedFrame, ...]
    shift_px: Field


@dataclass(frozen=True, slots=True)
class Experiment:
    """A case with a seed.

    Attributes:
        case: the case.
        seed: decides everything random.
        grid: of the maps.
        world: the truth.
        pairs: in order.
    """

    case: Case
    seed: int
    grid: Grid
    world: World
    pairs: tuple[Taken, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Where the frames of one pair show what.

    Attributes:
        pair: its number.
        phase: what it is for.
        motion: of the specimen.
        again_px: (n, 2) where the second frame shows what the first shows on the grid.
        there_px: (n, 2) where each frame shows what frame 0 shows on the grid; without frame 0 itself.
        displacement_px: (ny, nx, 2) true displacement of the material on the grid of frame 0.
    """

    pair: int
    phase: Phase
    motion: Motion
    again_px: Field
    there_px: dict[int, Field]
    displacement_px: Field


def make_experiment(case: Case, seed: int, grid: Grid = GRID, calibration_pairs: int = len(CROSS_PX)) -> Experiment:
    """The experiment of a case and a seed.

    Args:
        case: what differs from the paper's experiment.
        seed: drift, distortion, wander, stage errors and noise.
        grid: of the maps; the paper's by default.
        calibration_pairs: how many of the cross's 15 positions are visited.
    """
    world, sights = imaged(case.setting, seed, grid, calibration_pairs)
    noise = FrameNoise(case.noise, case.noise_px, seed, WIDTH_PX, HEIGHT_PX)
    here = _points(grid)
    return Experiment(case, seed, grid, world, tuple(_taken(noise, grid, here, item) for item in sights))


@lru_cache(maxsize=1)
def imaged(setting: Setting, seed: int, grid: Grid, calibration_pairs: int) -> tuple[World, tuple[Sights, ...]]:
    """The world of a setting and what its frames show; kept while only the noise changes."""
    rng = np.random.default_rng((seed, 2007))
    count = calibration_pairs + setting.load_steps
    world = make_world(rng, start_s(2 * count) - PAUSE_S, setting.effects(seed), setting.carried)
    here, rest = _points(grid), lying((0.0, 0.0), np.zeros((2, 2)))
    material = world.material_px(here, 0, rest)
    poses = _poses(rng, calibration_pairs, setting.load_steps)
    return world, tuple(_sights(world, grid, here, material, pair, *pose) for pair, pose in enumerate(poses))


def _sights(world: World, grid: Grid, here: Field, material: Field, pair: int, phase: Phase, motion: Motion) -> Sights:
    first, second = 2 * pair, 2 * pair + 1
    again = world.address_px(world.material_px(here, first, motion), second, motion, here)
    moved = motion.shift_px[0] + (material - SCAN.centre_px) @ motion.gradient[0].T
    there = {first: world.address_px(material, first, motion, here + moved)} if pair else {}
    there[second] = world.address_px(material, second, motion, there[first]) if pair else again
    return Sights(pair, phase, motion, again, there, moved.reshape(*grid.shape, 2))


def _taken(noise: FrameNoise, grid: Grid, here: Field, sights: Sights) -> Taken:
    first, second = 2 * sights.pair, 2 * sights.pair + 1
    maps, observed = [_map(noise, grid, first, second, here, sights.again_px)], []
    for frame, there in sights.there_px.items():
        if sights.pair:
            maps.append(_map(noise, grid, 0, frame, here, there))
        observed.append(ObservedFrame(_map(None, grid, 0, frame, here, there), sights.displacement_px, sights.motion.gradient[0]))
    times = tuple(FrameTime(frame, start_s(frame), timing()) for frame in (first, second))
    return Taken(sights.pair, sights.phase, (times[0], times[1]), tuple(maps), tuple(observed), sights.motion.shift_px[0])


def _points(grid: Grid) -> Field:
    return np.stack(grid.mesh(), axis=-1).reshape(-1, 2)


def _map(noise: FrameNoise | None, grid: Grid, reference: int, current: int, before: Field, after: Field) -> DisparityMap:
    moved, sd_px = after - before, 0.0
    if noise is not None:
        moved = moved + noise.at(current, after) - noise.at(reference, before)
        sd_px = noise.map_sd_px
    u, v = (np.ascontiguousarray(item.reshape(grid.shape)) for item in moved.T)
    sigma, item = np.full(grid.shape, sd_px), np.ones(grid.shape)
    return DisparityMap(reference, current, grid, u, v, sigma, sigma, item, np.zeros(grid.shape, np.uint8))


def _poses(rng: np.random.Generator, calibration_pairs: int, load_steps: int) -> Iterator[tuple[Phase, Motion]]:
    """The cross, then load steps; under load the field of view is carried along, and stays within the calibrated translations."""
    for pair, shift in enumerate(CROSS_PX[:calibration_pairs]):
        error = rng.normal(0.0, STAGE_ERROR_PX, 2) if pair else np.zeros(2)
        yield Phase.CALIBRATION, lying((shift[0] + error[0], shift[1] + error[1]), np.zeros((2, 2)))
    for step in range(load_steps):
        strain = TOP_STRAIN * step / (load_steps - 1)
        shift = np.array([1.5, -2.0]) * step + rng.normal(0.0, STAGE_ERROR_PX, 2)
        yield Phase.TENSION, lying((shift[0], shift[1]), np.diag([-POISSON * strain, strain]))


def timing(scan: Scan = SCAN) -> ScanTiming:
    """The scan timing that the estimator receives."""

    def from_config(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    return ScanTiming(
        from_config(scan.dwell_time_s), from_config(scan.row_time_s), from_config(scan.frame_time_s), Sourced(1, Provenance.CONFIG)
    )
