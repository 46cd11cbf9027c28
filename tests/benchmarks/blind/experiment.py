"""Experiments with something hidden in them, at displacement level: the simulators' own effects, no images.

Every frame's scan addresses solve the simulators' forward equation, effects at every point included, until they stand still.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeAlias, cast

import numpy as np
from numexp.experiment import CROSS_PX, POISSON, STAGE_ERROR_PX, TOP_STRAIN, timing
from numexp.noise import FrameNoise, NoiseKind
from numexp.world import HEIGHT_PX, PAUSE_S, SCAN, WIDTH_PX, World, make_world, start_s
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive_simulators.effects.distortion import Distortion
from semlive_simulators.effects.interfaces import Effect, Instants, PixelVisits
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.specimen.history import History, LoadStep, Move
from semlive_simulators.specimen.specimen import Motion, at_rest

Field: TypeAlias = NDArray[np.float64]
GRID = Grid(101, 101, 5, 150, 120, 43)
COARSE = Grid(101, 101, 60, 13, 10, 43)
HOLD_S = 30.0
AREA_MM2, YOUNGS_GPA = 10.0, 71.1
STANDS_STILL_PX, MAX_ITERATIONS = 1e-9, 40
ROW_PX = 3
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
_NOBODY = np.zeros((1, 1), dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class Pose:
    """How the specimen lies in one pair, and what was done to get it there."""

    pair: int
    phase: Phase
    motion: Motion
    commanded_px: tuple[float, float]
    load_n: float


@dataclass(frozen=True, slots=True)
class HiddenPair:
    """One pair as diagnosis gets it."""

    pose: Pose
    times: tuple[FrameTime, FrameTime]
    maps: tuple[DisparityMap, ...]


@dataclass(frozen=True, slots=True)
class Conditions:
    """What varies from case to case besides the effect.

    Attributes:
        seed: drift, distortion, stage errors, noise.
        calibration: pairs of the cross.
        tension: pairs under load.
        noise_px: standard deviation of a map's component.
        kind: how noise is shared between points.
        missing: share of the points that are lost.
        outliers: share of the points that are wrong.
        bias_px: amplitude of the correlation's own bias over fractions of a pixel.
        sway: effects that are nobody's fault: wandering drift.
        scan: the raster.
        bent_like: the seed of an experiment with the same distortion; None for one of its own.
        noise_seed: of noise, lost and wrong points alone; None takes the seed of everything.
        parked: whether the stage stays where it is.
        moves_px: commanded stage positions, as far as there are pairs.
        stage_error_px: standard deviation of where it gets to, along each axis.
        of_column: whether the distortion stays with the column where the scan is turned, and does not turn with it.
        injected: strain along y that every pair under load has besides.
        subset_px: edge of what a point's displacement is the mean of; 0 for the point alone.
        pause_s: mean of what every pause is longer by, exponentially distributed.
        clock_sd_s: standard deviation of the error of a reported start.
        lost_px: radius of a disc that is lost in every map, and of another in every third.
    """

    seed: int
    calibration: int = 8
    tension: int = 7
    noise_px: float = 0.02
    kind: NoiseKind = NoiseKind.CORRELATED
    missing: float = 0.01
    outliers: float = 0.001
    bias_px: float = 0.0
    sway: tuple[Effect, ...] = ()
    scan: Scan = SCAN
    bent_like: int | None = None
    noise_seed: int | None = None
    parked: bool = False
    moves_px: tuple[tuple[float, float], ...] = CROSS_PX
    stage_error_px: float = STAGE_ERROR_PX
    of_column: bool = False
    injected: float = 0.0
    subset_px: int = 0
    pause_s: float = 0.0
    clock_sd_s: float = 0.0
    lost_px: float = 0.0

    @property
    def noisy(self) -> int:
        """The seed of what differs where everything is measured again."""
        return self.seed if self.noise_seed is None else self.noise_seed

    def begin_s(self, frame: int) -> float:
        """When a frame begins."""
        if not self.pause_s:
            return start_s(frame)
        return start_s(frame) + float(np.random.default_rng((self.seed, 15)).exponential(self.pause_s, frame).sum())


def poses(conditions: Conditions) -> list[Pose]:
    """The cross, then load steps; what was done is in each pose's history."""
    rng = np.random.default_rng((conditions.seed, 8))
    found: list[Pose] = []
    moves: list[Move] = []
    steps: list[LoadStep] = []
    before_px, before_n = (0.0, 0.0), 0.0
    for pair in range(conditions.calibration + conditions.tension):
        when_s = conditions.begin_s(2 * pair) - HOLD_S
        loaded = pair >= conditions.calibration
        strain = TOP_STRAIN * (pair - conditions.calibration) / max(conditions.tension - 1, 1) if loaded else 0.0
        load_n = strain * YOUNGS_GPA * 1e3 * AREA_MM2
        required = before_px if loaded or conditions.parked else conditions.moves_px[pair]
        if required != before_px:
            moves.append(Move(when_s, before_px, required))
        if load_n != before_n:
            steps.append(LoadStep(when_s, load_n - before_n))
        error = rng.normal(0.0, conditions.stage_error_px, 2) if pair and not conditions.parked else np.zeros(2)
        carried = np.array([1.5, -2.0]) * (pair - conditions.calibration) if loaded else np.zeros(2)
        shift = (float(required[0] + error[0] + carried[0]), float(required[1] + error[1] + carried[1]))
        history = History(tuple(steps), tuple(moves))
        motion = at_rest(shift, np.diag([-POISSON * strain, strain + (conditions.injected if loaded else 0.0)]), load_n, history)
        found.append(Pose(pair, Phase.TENSION if loaded else Phase.CALIBRATION, motion, required, load_n))
        before_px, before_n = required, load_n
    return found


def hidden(conditions: Conditions, effects: tuple[Effect, ...], grid: Grid = GRID) -> list[HiddenPair]:
    """All pairs of an experiment, with noise."""
    reported = poses(conditions)
    world = world_of(conditions, effects)
    noise = FrameNoise(conditions.kind, conditions.noise_px, conditions.noisy, WIDTH_PX, HEIGHT_PX)
    points = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
    reference_noise = noise.at(0, points)  # of frame 0, which is in every map
    subsets = Subsets.of(grid, conditions.subset_px)
    here = subsets.places
    material = observed_at(world, here, 0, reported[0].motion, conditions.begin_s(0))
    found = []
    for pose in reported:
        first, second = 2 * pose.pair, 2 * pose.pair + 1
        strained = (material - world.column.scan.centre_px) @ pose.motion.gradient[0].T
        near = here + _by_scan(world, pose.motion.shift_px[0]) + _by_scan(world, strained)
        begin_s = {frame: conditions.begin_s(frame) for frame in (first, second)}
        there = {first: address(world, material, first, pose.motion, near, begin_s[first])} if pose.pair else {}
        there[second] = address(world, material, second, pose.motion, there[first] if pose.pair else near, begin_s[second])
        maps = []
        for frame, at in there.items():
            maps.append(_map((noise, reference_noise), conditions, grid, frame, points, points + subsets.mean(at - here)))
        times = tuple(
            FrameTime(frame, at_s + _clock_error_s(conditions, frame), timing(conditions.scan)) for frame, at_s in begin_s.items()
        )
        found.append(HiddenPair(pose, (times[0], times[1]), tuple(maps)))
    return found


@dataclass(frozen=True, slots=True)
class Subsets:
    """Places in the subsets of all points, on rows and columns that overlapping subsets share.

    A row has a time of its own, so a jump within a frame is a mean over all rows of a subset, as a correlation has it. With three rows
    of Gauss and Legendre, it had three steps of 1.8 s.

    Attributes:
        places: (n, 2) scan addresses.
        shape: points along y and x.
        rows: of a subset.
        stride: rows from one point to the next.
    """

    places: Field
    shape: tuple[int, int]
    rows: int
    stride: int

    @classmethod
    def of(cls, grid: Grid, subset_px: int) -> Subsets:
        """Rows about `ROW_PX` apart; three columns of Gauss and Legendre. The points alone if there is no subset."""
        stride = -(-grid.step_px // ROW_PX) if subset_px else 1
        row_px = grid.step_px / stride
        half = round(0.5 * (subset_px / row_px - 1.0)) if subset_px else 0
        y = grid.y0_px + row_px * np.arange(-half, stride * (grid.ny - 1) + half + 1)
        x = grid.x0_px + grid.step_px * np.arange(grid.nx)[:, None] + (0.5 * subset_px * NODES if subset_px else 0.0)
        places = np.stack(np.meshgrid(x.ravel(), y), axis=-1).reshape(-1, 2)
        return cls(places, grid.shape, 2 * half + 1, stride)

    def mean(self, moved: Field) -> Field:
        """(points, 2) means of values (n, 2) at the places."""
        ny, nx = self.shape
        along_x = moved.reshape(-1, nx, len(moved) // (nx * self._height), 2)
        along_x = along_x[:, :, 0] if along_x.shape[2] == 1 else np.einsum("s,yxsc->yxc", 0.5 * WEIGHTS, along_x)
        windows = np.lib.stride_tricks.sliding_window_view(along_x, self.rows, axis=0)[:: self.stride]
        return windows.mean(axis=-1).reshape(ny * nx, 2)

    @property
    def _height(self) -> int:
        return self.stride * (self.shape[0] - 1) + self.rows


def _clock_error_s(conditions: Conditions, frame: int) -> float:
    return conditions.clock_sd_s * float(np.random.default_rng((conditions.noisy, 13, frame)).normal()) if conditions.clock_sd_s else 0.0


def _lost(conditions: Conditions, grid: Grid, frame: int) -> NDArray[np.bool_]:
    x, y = grid.mesh()
    lost = np.zeros(grid.shape, np.bool_)
    for place in (0,) if frame % 3 else (0, frame):
        centre = np.random.default_rng((conditions.noisy, 14, place)).uniform((x.min(), y.min()), (x.max(), y.max()))
        lost |= np.hypot(x - centre[0], y - centre[1]) < conditions.lost_px
    return lost


def world_of(conditions: Conditions, effects: tuple[Effect, ...] = ()) -> World:
    """The microscope of an experiment."""
    return _world(conditions, conditions.begin_s(2 * (conditions.calibration + conditions.tension)) - PAUSE_S, effects)


def _world(conditions: Conditions, run_s: float, effects: tuple[Effect, ...]) -> World:
    seeds = [conditions.seed] if conditions.bent_like is None else [conditions.bent_like, conditions.seed]
    distortion = None
    for seed in seeds:
        rng = np.random.default_rng((seed, 2007))
        world = make_world(rng, run_s, (*conditions.sway, *effects), False, conditions.scan, distortion)
        distortion = world.distortion
    if not conditions.of_column:
        return world
    return replace(world, distortion=cast(Distortion, OfColumn.in_world(world)))


@dataclass(frozen=True, slots=True, eq=False)
class OfColumn:
    """A distortion of the column, as a scan that is turned, stretched or skewed has it at its own addresses.

    Attributes:
        own: at places that the beam would be at without it.
        raster: (2, 2) from addresses to those places, about the centre.
    """

    own: Distortion
    raster: Field

    @classmethod
    def in_world(cls, world: World) -> OfColumn:
        """That of a world with a constant scan."""
        scan = world.column.scan
        bent = world.column.effects.deflection(Instants(np.zeros(1), 0.0, 0, scan, at_rest((0.0, 0.0), np.zeros((2, 2)))))
        return cls(world.distortion, scan.rotation if bent is None else scan.rotation @ (np.eye(2) - bent[0]))

    def at(self, x_px: Field, y_px: Field, width_px: int, height_px: int) -> Field:
        """(..., 2) px at scan addresses, along the scan's axes."""
        centre = 0.5 * np.array([width_px - 1, height_px - 1])
        place = (np.stack((x_px, y_px), axis=-1) - centre) @ self.raster.T + centre
        return self.own.at(place[..., 0], place[..., 1], width_px, height_px) @ np.linalg.inv(self.raster).T


def largest_px(conditions: Conditions, effects: tuple[Effect, ...]) -> float:
    """The largest displacement that effects add to a point of any map."""
    return float(np.max(np.hypot(*_added(conditions, effects))))


def beyond_shear_px(conditions: Conditions, effects: tuple[Effect, ...]) -> float:
    """The largest residual of it when rows may slide over each other in every map as they like: u = a + g y."""
    u, v = _added(conditions, effects)
    rows = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, COARSE.ny), 2))[0]
    slid = np.einsum("ya,za,fzx->fyx", rows, rows, u.mean(axis=2, keepdims=True))
    return float(np.max(np.hypot(u - slid, v)))


def _added(conditions: Conditions, effects: tuple[Effect, ...]) -> Field:
    """(2, maps, ny, nx) px along x and y that effects add to every map."""
    silent = replace(conditions, kind=NoiseKind.NONE, missing=0.0, outliers=0.0)
    return np.asarray(np.stack(_displacements(silent, effects)) - _nothing_added(silent))


@lru_cache(maxsize=1)
def _nothing_added(conditions: Conditions) -> Field:
    """Cases follow each other that have the same conditions."""
    return np.stack(_displacements(conditions, ()))


def _displacements(conditions: Conditions, effects: tuple[Effect, ...]) -> tuple[Field, Field]:
    maps = [item for pair in hidden(conditions, effects, COARSE) for item in pair.maps]
    return np.stack([item.u_px for item in maps]), np.stack([item.v_px for item in maps])


def address(world: World, material: Field, frame: int, motion: Motion, near: Field, begin_s: float) -> Field:
    """(n, 2) scan addresses at which a frame shows material points (n, 2)."""
    at = near
    for _ in range(MAX_ITERATIONS):
        wrong = observed_at(world, at, frame, motion, begin_s) - material
        at = at - _by_scan(world, wrong)
        if np.max(np.abs(wrong)) < STANDS_STILL_PX:
            return at
    raise RuntimeError(f"scan addresses of frame {frame} do not converge")


def _by_scan(world: World, moved: Field) -> Field:
    """Displacements (..., 2) along the column's axes, along those of the scan."""
    return moved @ world.column.scan.rotation if world.column.scan.rotation_rad else moved


def observed_at(world: World, at: Field, frame: int, motion: Motion, begin_s: float) -> Field:
    """(n, 2) material points that a frame with such a start time shows at scan addresses (n, 2)."""
    column, scan, timing_ = world.column, world.column.scan, world.column.timing
    rows = np.arange(scan.height_px)
    visits = []
    for row_start_s in timing_.row_start_s:
        in_frame = np.interp(at[:, 1], rows, row_start_s) + at[:, 0] * timing_.dwell_time_s
        beyond = at[:, 1] - np.clip(at[:, 1], 0, scan.height_px - 1)
        time_s = begin_s + in_frame + beyond * timing_.row_time_s
        bend = world.bend_px(at)
        visit = PixelVisits(
            at[:, :1], at[:, 1:], time_s[:, None], begin_s, frame, 0, _NOBODY, scan, motion, (bend[:, :1], bend[:, 1:])
        )  # fmt: skip
        shifted = at - bend
        for u, v in column.effects.offset_px(visit):
            shifted = shifted - np.concatenate(np.broadcast_arrays(u, v, at[:, :1])[:2], axis=1)
        maps = column.row_maps(time_s, motion, begin_s, frame)
        point = np.einsum("nij,nj->ni", maps[:, :, :2], shifted) + maps[:, :, 2]
        visits.append(_undeformed(world, point, visit, np.linalg.inv(np.eye(2) + motion.gradient[0])))
    return np.mean(visits, axis=0)


def _undeformed(world: World, point: Field, visit: PixelVisits, inverse: Field) -> Field:
    found = point
    for _ in range(6):
        moved = world.column.effects.material_px(found[:, :1], found[:, 1:], visit)
        if not moved:
            return point
        found = point - sum(np.concatenate(np.broadcast_arrays(u, v, found[:, :1])[:2], axis=1) for u, v in moved) @ inverse.T
    return found


def _map(noises: tuple[FrameNoise, Field], conditions: Conditions, grid: Grid, frame: int, here: Field, there: Field) -> DisparityMap:
    noise, reference_noise = noises
    rng = np.random.default_rng((conditions.noisy, 11, frame))
    exact = there - here
    moved = exact + noise.at(frame, there) - reference_noise + conditions.bias_px * np.sin(2 * np.pi * exact)
    status = np.full(grid.shape, PoiStatus.CONVERGED, np.uint8)
    status[rng.random(grid.shape) < conditions.missing] = PoiStatus.LOW_ZNCC
    status[_lost(conditions, grid, frame)] = PoiStatus.LOW_ZNCC
    wrong = (rng.random(len(here)) < conditions.outliers)[:, None] * rng.normal(0.0, 1.0, here.shape)
    lost = (status != PoiStatus.CONVERGED).ravel()[:, None]
    u, v = (np.ascontiguousarray(item.reshape(grid.shape)) for item in np.where(lost, 0.0, moved + wrong).T)
    sigma = np.where(status == PoiStatus.CONVERGED, conditions.noise_px, 0.0)
    return DisparityMap(0, frame, grid, u, v, sigma, sigma, np.ones(grid.shape), status)
