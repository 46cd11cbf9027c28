"""The recommended protocol against random ones of equal beam time, by the strain error of a simulated run with each.

Microscopes differ in noise, warm-up, drift and distortion. Maps are made without images: a point p of the specimen is scanned at
R = p + shift + strain (p - centre) + distortion(R) + drift(time of R), the drift being the mean over integrated scans. Noise is shared over
subsets, and decreases with the square root of dwell time and integrated scans. All protocols of a microscope have the noise of one seed.
The best of many is better with that noise than with another, so the recommended one and the best are evaluated again with other seeds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numexp.noise import FrameNoise, NoiseKind
from numexp.world import Field, make_world
from qualify_tensile import NOISE_PX

from semlive import estimate, mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.dic import CorrelationChoice
from semlive.dic.image_quality.row_structure import RowStructure
from semlive.qualify.figures.drift import DriftRates, decay_results, pair_rate, rate_results
from semlive.qualify.figures.noise import displacement_scatter
from semlive.qualify.protocol import STEPS, recommend_protocol
from semlive.qualify.values import Conditions, Figure
from semlive_simulators.effects.distortion import Distortion
from semlive_simulators.effects.drift import AxisDrift, Drift

FIRST_SEED = 91_000
WIDTH_PX, HEIGHT_PX, DWELL_S, ROW_S = 512, 442, 1e-4, 0.06
"""Frames a quarter as large as those of the other tables: an estimate takes a tenth of the processor time."""
GRID, WINDOW_POINTS = Grid(65, 65, 20, 20, 16, 43), 3
"""Points of the maps; a gauge is 83 px long."""
KNOT_PX = 128.0
"""Knot distance of the distortion, of which a wave has 465 px or more."""
FRAME_S, GAP_S, STAGE_ERROR_PX = HEIGHT_PX * ROW_S, 0.4, 0.8
STRAINS, POISSON = (1e-3, 1.5e-3, 2e-3, 2.5e-3, 3e-3), 0.33
CENTRE_PX = np.array([0.5 * WIDTH_PX, 0.5 * HEIGHT_PX])
MAX_FACTOR, MIN_FACTOR = 6.0, 0.2
FRESH = 2
"""Further seeds."""
CHOICE = CorrelationChoice("subset", GRID.subset_px, 10, 0.0, 0.0, 1.0, RowStructure(0.0, 0.0), "")
IN_PLACE = ((0.0, 0.0),) * 4
"""Pairs in place of the qualification, before its cross of shifts."""


@dataclass(frozen=True, slots=True)
class Tried:
    """A protocol.

    Attributes:
        wait_s: waiting time before the first pair.
        factor: dwell time, as a multiple of that of the qualification.
        integrations: scans that are integrated into a frame.
        shifts_px: shifts of the calibration pairs.
        repeats: pairs at each load, whose strain is averaged.
        hold_s: hold before each pair.
    """

    wait_s: float
    factor: float
    integrations: int
    shifts_px: tuple[tuple[float, float], ...]
    repeats: int
    hold_s: float

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return len(self.shifts_px) + self.repeats * len(STRAINS)

    @property
    def pair_s(self) -> float:
        """Duration of a pair."""
        return self.hold_s + 2.0 * (self.integrations * self.factor * FRAME_S + GAP_S)

    @property
    def beam_s(self) -> float:
        """Beam time."""
        return self.wait_s + self.pairs * self.pair_s


@dataclass(frozen=True, slots=True, eq=False)
class Microscope:
    """Truth of a microscope: drift since the specimen was inserted, distortion, and noise of a displacement at factor 1."""

    seed: int
    drift: Drift
    distortion: Distortion
    noise_px: float


def microscope(number: int) -> Microscope:
    """A random microscope."""
    seed = FIRST_SEED + number
    rng = np.random.default_rng((seed, 37))
    axes = (
        AxisDrift(
            rng.uniform(1.0, 8.0) * rng.choice([-1.0, 1.0]),
            rng.uniform(300.0, 1500.0),
            rng.uniform(1e-4, 1e-3) * rng.choice([-1.0, 1.0]),
            0.0,
        )
        for _ in range(2)
    )
    low, high = np.log(NOISE_PX)
    noise_px = float(np.exp(rng.uniform(low, high)))
    return Microscope(seed, Drift(*axes), make_world(rng, 6000.0, (), False).distortion, noise_px)


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Frames of a run with one protocol; pair k has the frames 2k and 2k + 1."""

    truth: Microscope
    tried: Tried
    noise: FrameNoise
    motions: tuple[tuple[Phase, Field, Field], ...]

    def start_s(self, frame: int) -> float:
        """Start of a frame, s since the specimen was inserted."""
        tried = self.tried
        frame_s = tried.integrations * tried.factor * FRAME_S + GAP_S
        return tried.wait_s + tried.hold_s + (frame // 2) * tried.pair_s + (frame % 2) * frame_s

    def bent_px(self, address: Field, frame: int) -> Field:
        """(n, 2) distortion and drift at scan addresses."""
        tried = self.tried
        first_s = self.start_s(frame) + tried.factor * (address[:, 0] * DWELL_S + address[:, 1] * ROW_S)
        visits = [self.truth.drift.at(first_s + scan * tried.factor * FRAME_S) for scan in range(tried.integrations)]
        return self.truth.distortion.at(address[:, 0], address[:, 1], WIDTH_PX, HEIGHT_PX) + np.mean(visits, axis=0)

    def material_px(self, address: Field, frame: int) -> Field:
        """(n, 2) points of the specimen at scan addresses."""
        _, shift, gradient = self.motions[frame // 2]
        return CENTRE_PX + (address - self.bent_px(address, frame) - shift - CENTRE_PX) @ np.linalg.inv(np.eye(2) + gradient).T

    def address_px(self, material: Field, frame: int, near: Field) -> Field:
        """(n, 2) scan addresses of points of the specimen; drift and distortion change by 0.5 % of a step at most, so six steps suffice."""
        _, shift, gradient = self.motions[frame // 2]
        moved, address = material + shift + (material - CENTRE_PX) @ gradient.T, near
        for _ in range(6):
            address = moved + self.bent_px(address, frame)
        return address

    def disparity(self, reference: int, current: int, grid: Grid) -> DisparityMap:
        """A map with noise."""
        before = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
        after = self.address_px(self.material_px(before, reference), current, before)
        moved = after - before + self.noise.at(current, after) - self.noise.at(reference, before)
        u, v = (np.ascontiguousarray(part.reshape(grid.shape)) for part in moved.T)
        sigma, ones = np.full(grid.shape, self.noise.map_sd_px), np.ones(grid.shape)
        return DisparityMap(reference, current, grid, u, v, sigma, sigma, ones, np.zeros(grid.shape, np.uint8))

    def times(self, pair: int) -> tuple[FrameTime, FrameTime]:
        """Times of both frames of a pair."""
        tried = self.tried
        values = (tried.factor * DWELL_S, tried.factor * ROW_S, tried.factor * FRAME_S)
        dwell, row, frame_s = (Sourced(value, Provenance.CONFIG) for value in values)
        timing = ScanTiming(dwell, row, frame_s, Sourced(tried.integrations, Provenance.CONFIG))
        first, second = (FrameTime(frame, self.start_s(frame) - self.start_s(0), timing) for frame in (2 * pair, 2 * pair + 1))
        return first, second


def frames_of(truth: Microscope, tried: Tried, seed: int) -> Frames:
    """Frames of a run; stage errors and noise are drawn by the seed."""
    rng = np.random.default_rng((seed, 11))
    noise_px = truth.noise_px / float(np.sqrt(tried.factor * tried.integrations))
    motions: list[tuple[Phase, Field, Field]] = []
    for number, shift in enumerate(tried.shifts_px):
        error = rng.normal(0.0, STAGE_ERROR_PX, 2) if number else np.zeros(2)
        motions.append((Phase.CALIBRATION, np.array(shift) + error, np.zeros((2, 2))))
    for step, strain in enumerate(STRAINS, 1):
        shift = np.array([1.5, -2.0]) * step + rng.normal(0.0, STAGE_ERROR_PX, 2)
        motions += [(Phase.TENSION, shift, np.diag([-POISSON * strain, strain]))] * tried.repeats
    return Frames(truth, tried, FrameNoise(NoiseKind.CORRELATED, noise_px, seed, WIDTH_PX, HEIGHT_PX), tuple(motions))


def recommended(truth: Microscope) -> Tried:
    """The protocol that is recommended after the plan of a qualification."""
    largest = 13.0
    shifts = (*IN_PLACE, *((0.5 * largest * x, 0.5 * largest * y) for x, y in STEPS))
    frames = frames_of(truth, Tried(0.0, 1.0, 1, shifts, 1, 30.0), truth.seed + 500_000)
    maps = [frames.disparity(2 * pair, 2 * pair + 1, GRID) for pair in range(len(shifts))]
    starts = np.array([[when.start_s for when in frames.times(pair)] for pair in range(len(shifts))])
    found = [pair_rate(dmap, end - begin, 0.0, ROW_S) for dmap, (begin, end) in zip(maps, starts, strict=True)]
    rate, sigma = (np.array(values) for values in zip(*found, strict=True))
    rates = DriftRates(starts.mean(axis=1), rate, sigma, FRAME_S, FRAME_S + GAP_S)
    scatter = displacement_scatter(maps)
    assert scatter is not None  # the grid is large enough
    results = [*rate_results(rates, ROW_S, 0.0, timed=True), *decay_results(rates)]
    figures = {item.name: item for item in results if isinstance(item, Figure)}
    figures["noise_43"] = Figure("noise_43", "", *scatter.worst(), "px")
    conditions = Conditions("", 0, 2 * len(maps), len(maps), WIDTH_PX, HEIGHT_PX, DWELL_S, ROW_S, FRAME_S, 0.0, "", True)
    advice = recommend_protocol(conditions, figures, CHOICE)
    return Tried(advice.warm_up_s, advice.dwell_factor, 1, advice.shifts_px, 1, advice.hold_s)


def others(best: Tried, seed: int, count: int) -> Iterator[Tried]:
    """Random protocols with the beam time of another: waiting, integration, calibration and repeats are drawn, dwell is what remains."""
    rng = np.random.default_rng((seed, 13))
    largest = max(abs(value) for shift in best.shifts_px for value in shift)
    while count:
        wait_s = float(rng.choice([0.0, 300.0, 900.0, 1800.0])) if rng.random() < 0.5 else best.wait_s * float(rng.choice([0.5, 1.0, 1.5]))
        size_px, pairs = largest * float(rng.choice([0.3, 0.6, 1.0, 1.5])), int(rng.choice([3, 4, 5, 7, 9, 13]))
        cross = (*STEPS, *STEPS[1:5]) if pairs > 4 else (STEPS[0], STEPS[1], STEPS[4], STEPS[0])
        cross = (STEPS[0], *STEPS[1:3], *STEPS[4:6], STEPS[3], STEPS[6]) if pairs in (5, 7) else cross
        shifts = tuple((0.5 * size_px * x, 0.5 * size_px * y) for x, y in cross[:pairs])
        tried = Tried(wait_s, 1.0, int(rng.choice([1, 2, 4])), shifts, int(rng.choice([1, 2])), best.hold_s)
        frame_s = 0.5 * ((best.beam_s - wait_s) / tried.pairs - tried.hold_s) - GAP_S
        factor = frame_s / (tried.integrations * FRAME_S)
        same = (tried.wait_s, tried.shifts_px, tried.repeats) == (best.wait_s, best.shifts_px, best.repeats)
        if MIN_FACTOR <= factor <= MAX_FACTOR and not same:
            count -= 1
            yield replace(tried, factor=factor)


def strain_error(truth: Microscope, tried: Tried, seed: int) -> float:
    """Root mean square error of the strain of gauges, over exx, eyy, exy, and loads, after the averages of repeated pairs."""
    frames, phases = frames_of(truth, tried, seed), (len(tried.shifts_px), tried.pairs)
    loaded, state = (
        dict[int, tuple[DisparityMap, ...]](),
        estimate.init(EstimateSettings(window_points=WINDOW_POINTS, distortion_knot_px=KNOT_PX), GRID, WIDTH_PX, HEIGHT_PX),
    )
    for pair, (phase, _, _) in enumerate(frames.motions):
        numbers = (2 * pair, 2 * pair + 1)
        maps = (frames.disparity(*numbers, GRID), *(frames.disparity(0, frame, GRID) for frame in numbers if pair))
        state = estimate.update(state, pair, phase, frames.times(pair), maps)
        loaded[pair] = maps[1:]
    solution = estimate.solve(state)
    errors = list[Field]()
    for pair in range(*phases):
        strain = frames.motions[pair][2]
        true = np.array([strain[0, 0], strain[1, 1], 0.0])
        for dmap in loaded[pair]:
            field = mechanics.strain(mechanics.displacement(dmap, estimate.correction(solution, dmap)), WINDOW_POINTS)
            errors.append(np.stack((field.exx, field.eyy, field.exy), axis=-1) - true)
    half = WINDOW_POINTS // 2
    by_load = np.array(errors).reshape(len(STRAINS), 2 * tried.repeats, *errors[0].shape).mean(axis=1)
    return float(np.sqrt(np.mean(by_load[:, half:-half, half:-half] ** 2)))


@dataclass(frozen=True, slots=True)
class Contest:
    """The recommended protocol against random ones.

    Attributes:
        noise_px: noise of a displacement at factor 1.
        recommended: its protocol.
        best: random protocol with the smallest error.
        first: errors of both with the seed that selected the best.
        again: (2, seeds) errors of both with other seeds.
        median: error of the random protocols with the first seed.
    """

    noise_px: float
    recommended: Tried
    best: Tried
    first: tuple[float, float]
    again: Field
    median: float

    @property
    def ratio(self) -> float:
        """Error of the recommended protocol over that of the best, with other seeds than those that selected it."""
        recommended, best = np.sqrt(np.mean(self.again**2, axis=1))
        return float(recommended / best)


def contest(number: int, count: int) -> Contest:
    """Compare the recommended protocol of a microscope with `count` random ones of equal beam time."""
    truth = microscope(number)
    advice = recommended(truth)
    found = [(strain_error(truth, tried, truth.seed), tried) for tried in others(advice, truth.seed, count)]
    error, best = min(found, key=lambda item: item[0])
    again = [[strain_error(truth, tried, truth.seed + 100_000 * (1 + seed)) for seed in range(FRESH)] for tried in (advice, best)]
    first = (strain_error(truth, advice, truth.seed), error)
    return Contest(truth.noise_px, advice, best, first, np.array(again), float(np.median([each for each, _ in found])))
