"""Five pairs of small frames with a distortion that bends by 2 px in 276: the bench of the daemon's own tests, without images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numexp.noise import FrameNoise, NoiseKind
from numpy.typing import NDArray

from semlive import estimate as estimating
from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.solution.posterior import Solution
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.specimen import at_rest

WIDTH_PX, HEIGHT_PX, FRAME_S, DWELL_S = 320, 276, 9.4, 1e-4
ROW_S = FRAME_S / HEIGHT_PX
GRID = Grid(15, 15, 8, 37, 31, 31)
SHIFTS_PX = ((0.0, 0.0), (6.1, 0.2), (-0.1, 5.9), (0.3, -0.2), (0.6, -1.2))
STARTS_S = (0.0, 56.6, 113.4, 175.8, 245.9)
STRAIN = 7e-4
NOISE_PX = 0.02
Field = NDArray[np.float64]


@dataclass
class SmallBench:
    """The paper's instrument with a frame a tenth as large; addresses solve the implicit equation of the simulators' column."""

    seed: int
    noise: FrameNoise = field(init=False)

    def __post_init__(self) -> None:
        scenario = replace(load_scenario("paper_x200"), scan=Scan(WIDTH_PX, HEIGHT_PX, DWELL_S, FRAME_S, 0.4, 1.25))
        self.column, self.distortion = scenario.column(), scenario.distortion
        self.noise = FrameNoise(NoiseKind.CORRELATED, NOISE_PX, self.seed, WIDTH_PX, HEIGHT_PX)
        self.here = np.stack(GRID.mesh(), axis=-1).reshape(-1, 2)

    def start_s(self, frame: int) -> float:
        return STARTS_S[frame // 2] + frame % 2 * (FRAME_S + 0.4)

    def imaged(self, at: Field, frame: int) -> tuple[Field, Field]:
        strain = STRAIN if frame // 2 == 4 else 0.0
        motion = at_rest(SHIFTS_PX[frame // 2], ((-0.33 * strain, 0.0), (0.0, strain)))
        time_s = 37.0 + self.start_s(frame) + at[:, 0] * DWELL_S + at[:, 1] * ROW_S
        bend = self.distortion.at(at[:, 0], at[:, 1], WIDTH_PX, HEIGHT_PX)
        return self.column.row_maps(time_s, motion, 37.0 + self.start_s(frame), frame), bend

    def map(self, reference: int, current: int) -> DisparityMap:
        maps, bend = self.imaged(self.here, reference)
        material = np.einsum("nij,nj->ni", maps[:, :, :2], self.here - bend) + maps[:, :, 2]
        at = self.here
        for _ in range(30):
            maps, bend = self.imaged(at, current)
            at = np.linalg.solve(maps[:, :, :2], (material - maps[:, :, 2])[..., None])[..., 0] + bend
        moved = at - self.here + self.noise.at(current, at) - self.noise.at(reference, self.here)
        u, v = (np.ascontiguousarray(item.reshape(GRID.shape)) for item in moved.T)
        sigma, item = np.full(GRID.shape, NOISE_PX), np.ones(GRID.shape)
        return DisparityMap(reference, current, GRID, u, v, sigma, sigma, item, np.zeros(GRID.shape, np.uint8))

    def pairs(self) -> Iterator[tuple[int, Phase, tuple[FrameTime, FrameTime], tuple[DisparityMap, ...]]]:
        times_s = [Sourced(value, Provenance.CONFIG) for value in (DWELL_S, ROW_S, FRAME_S)]
        timing = ScanTiming(times_s[0], times_s[1], times_s[2], Sourced(1, Provenance.CONFIG))
        for pair in range(len(SHIFTS_PX)):
            first, second = 2 * pair, 2 * pair + 1
            compared = [(first, second), *((0, frame) for frame in (first, second) if pair)]
            times = FrameTime(first, self.start_s(first), timing), FrameTime(second, self.start_s(second), timing)
            yield pair, Phase.CALIBRATION if pair < 3 else Phase.TENSION, times, tuple(self.map(*item) for item in compared)


@pytest.fixture(scope="module")
def solutions() -> list[Solution]:
    found = []
    for seed in (1, 2):
        state = estimating.init(EstimateSettings(), GRID, WIDTH_PX, HEIGHT_PX)
        for pair in SmallBench(seed).pairs():
            state = estimating.update(state, *pair)
        found.append(estimating.solve(state))
    return found


def test_a_drift_that_is_smooth_is_not_made_rough_in_place_of_the_distortion(solutions: list[Solution]) -> None:
    """The true second difference from knot to knot is 1e-5 px; in place of the distortion it was 0.056 px along y."""
    for item in solutions:
        assert max(part.size_px for part in item.hyper.drift) < 0.005


def test_the_noise_is_judged_with_the_smoothness_that_was_chosen(solutions: list[Solution]) -> None:
    """With the smoothness that is believed without data the scale was 1.5."""
    for item in solutions:
        assert 0.8 < item.hyper.noise_scale < 1.3
        assert item.noise_floor_px == pytest.approx(NOISE_PX, rel=0.3)


def test_the_strain_error_of_a_load_step_reaches_the_noise_limit(solutions: list[Solution]) -> None:
    """8e-5 of 7e-4 with drift made rough in place of the distortion; the remainder is the effect of 0.02 px of noise on two steps."""
    for item in solutions:
        joint = estimating.mean_strain_covariance(item, [6, 8])
        step = np.array([0.0, 0.0, -1.0, 1.0])
        motions = estimating.to_estimate(item, 0).motions
        printed = motions[4].gradient[1, 1] - motions[3].gradient[1, 1]
        sigma = float(np.sqrt(step @ joint @ step))
        assert estimating.mean_strain_covariance(item, [6, 8], step[None])[0, 0] == pytest.approx(sigma**2, rel=1e-9)
        assert sigma < 4e-5
        assert abs(printed - STRAIN) < 4.0 * sigma
