"""Disparity maps of the paper's numerical experiment (Sutton 2007, Figs. 4-7), made directly, without images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numexp.cases import Case
from numexp.noise import FrameNoise
from numexp.world import DWELL_S, HEIGHT_PX, PAUSE_S, ROW_S, SCAN, WIDTH_PX, Field, World, lying, make_world, start_s

from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive_simulators.specimen import Motion

GRID = Grid(101, 101, 5, 150, 120, 43)
ARM_PX = (8.0, -16.0, 24.0, -32.0, 16.0, -8.0, 32.0)
CROSS_PX = ((0.0, 0.0), *(shift for arm in ARM_PX for shift in ((arm, 0.0), (0.0, -arm))))
STAGE_ERROR_PX = 0.8  # the paper's translations were neither exact nor orthogonal (Fig. 15)
TOP_STRAIN, POISSON = 3e-3, 0.33


@dataclass(frozen=True, slots=True)
class Seen:
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
    """One pair: what the estimator is given, and what it must not see (`seen`).

    Attributes:
        pair: its number.
        phase: what it is for.
        times: of its frames.
        maps: noisy, as the pipeline correlates them: within the pair, and from frame 0 to each frame.
        seen: the truth of the frames that have a map from frame 0.
    """

    pair: int
    phase: Phase
    times: tuple[FrameTime, FrameTime]
    maps: tuple[DisparityMap, ...]
    seen: tuple[Seen, ...]


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


def make_experiment(case: Case, seed: int, grid: Grid = GRID, calibration_pairs: int = len(CROSS_PX)) -> Experiment:
    """The experiment of a case and a seed.

    Args:
        case: what differs from the paper's experiment.
        seed: drift, distortion, wander, stage errors and noise.
        grid: of the maps; the paper's by default.
        calibration_pairs: how many of the cross's 15 positions are visited.
    """
    rng = np.random.default_rng((seed, 2007))
    count = calibration_pairs + case.load_steps
    world = make_world(rng, start_s(2 * count) - PAUSE_S, case.effects(seed))
    noise = FrameNoise(case.noise, case.noise_px, seed, WIDTH_PX, HEIGHT_PX)
    poses = tuple(_poses(rng, calibration_pairs, case.load_steps))
    here = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
    reference = lying((0.0, 0.0), np.zeros((2, 2)))
    material = world.material_px(here, 0, reference)
    pairs = tuple(
        _taken(world, noise, grid, here, material, pair, phase, motion) for pair, (phase, motion) in enumerate(poses)
    )  # fmt: skip
    return Experiment(case, seed, grid, world, pairs)


def _taken(
    world: World, noise: FrameNoise, grid: Grid, here: Field, material: Field, pair: int, phase: Phase, motion: Motion
) -> Taken:  # fmt: skip
    first, second = 2 * pair, 2 * pair + 1
    own = world.material_px(here, first, motion)
    again = world.address_px(own, second, motion)
    maps, seen = [_map(noise, grid, first, second, here, again)], []
    for frame in (first, second) if pair else (second,):
        there = world.address_px(material, frame, motion)
        if pair:
            maps.append(_map(noise, grid, 0, frame, here, there))
        gradient = motion.gradient[0]
        moved = motion.shift_px[0] + (material - SCAN.centre_px) @ gradient.T
        seen.append(Seen(_map(None, grid, 0, frame, here, there), moved.reshape(*grid.shape, 2), gradient))
    times = tuple(FrameTime(frame, start_s(frame), timing()) for frame in (first, second))
    return Taken(pair, phase, (times[0], times[1]), tuple(maps), tuple(seen))


def _map(noise: FrameNoise | None, grid: Grid, reference: int, current: int, before: Field, after: Field) -> DisparityMap:
    moved, sd_px = after - before, 0.0
    if noise is not None:
        moved = moved + noise.at(current, after) - noise.at(reference, before)
        sd_px = noise.map_sd_px
    u, v = (np.ascontiguousarray(one.reshape(grid.shape)) for one in moved.T)
    sigma, one = np.full(grid.shape, sd_px), np.ones(grid.shape)
    return DisparityMap(reference, current, grid, u, v, sigma, sigma, one, np.zeros(grid.shape, np.uint8))


def _poses(rng: np.random.Generator, calibration_pairs: int, load_steps: int) -> Iterator[tuple[Phase, Motion]]:
    """The cross, then load steps; under load the field of view is carried along, and stays within the calibrated translations."""
    for pair, shift in enumerate(CROSS_PX[:calibration_pairs]):
        error = rng.normal(0.0, STAGE_ERROR_PX, 2) if pair else np.zeros(2)
        yield Phase.CALIBRATION, lying((shift[0] + error[0], shift[1] + error[1]), np.zeros((2, 2)))
    for step in range(load_steps):
        strain = TOP_STRAIN * step / (load_steps - 1)
        shift = np.array([1.5, -2.0]) * step + rng.normal(0.0, STAGE_ERROR_PX, 2)
        yield Phase.TENSION, lying((shift[0], shift[1]), np.diag([-POISSON * strain, strain]))


def timing() -> ScanTiming:
    """The scan timing that the estimator is told."""

    def known(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    return ScanTiming(known(DWELL_S), known(ROW_S), known(SCAN.frame_time_s), Sourced(1, Provenance.CONFIG))
