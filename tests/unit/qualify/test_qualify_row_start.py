"""Settling at the row start has its size and length, and the false strain contains it."""

from __future__ import annotations

import numpy as np
import pytest
from numexp.experiment import timing
from numexp.noise import FrameNoise, NoiseKind
from numpy.typing import NDArray

from semlive import estimate
from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.qualify.figures.distortion import DistortionDraws, draw_distortion
from semlive.qualify.protocol import STEPS

Array = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX, GAUGE_PX = 512, 442, 83
GRID = Grid(15, 15, 20, 24, 20, 31)
SHIFTS_PX = 7.0 * np.array(((0, 0), (0, 0), *STEPS), dtype=np.float64)
NOISE_PX = 0.06


def _distortion(x_px: Array, amplitude_px: float, length_px: float) -> Array:
    """Displacement along x: a smooth wave, and a settling with a size at the first column."""
    return 0.2 * np.sin(x_px / 120.0) + amplitude_px * np.exp(-(x_px - GRID.x_px[0]) / length_px)


def _draws(amplitude_px: float, length_px: float, seed: int) -> DistortionDraws:
    """Figures from maps of a specimen at rest that is shifted, with noise in each map."""
    x, y = GRID.mesh()
    noise = FrameNoise(NoiseKind.WHITE, NOISE_PX, seed, WIDTH_PX, HEIGHT_PX)
    state = estimate.init(EstimateSettings(), GRID, WIDTH_PX, HEIGHT_PX)
    material, start = x - _distortion(x, amplitude_px, length_px), np.stack((x, y), axis=-1).reshape(-1, 2)
    for pair, (shift_x, shift_y) in enumerate(SHIFTS_PX):
        place = x + shift_x
        for _ in range(30):
            place = material + shift_x + _distortion(place, amplitude_px, length_px)
        end = np.stack((place, y + shift_y), axis=-1).reshape(-1, 2)
        maps = [_map(noise, 2 * pair, 2 * pair + 1, end, end)]
        maps += [_map(noise, 0, frame, start, end) for frame in (2 * pair, 2 * pair + 1) if pair]
        times = [FrameTime(frame, 3000.0 * frame, timing()) for frame in (2 * pair, 2 * pair + 1)]
        state = estimate.update(state, pair, Phase.CALIBRATION, (times[0], times[1]), tuple(maps))
    solution = estimate.solve(state)
    return draw_distortion(solution, estimate.to_estimate(solution, 0).distortion, GAUGE_PX)


def _map(noise: FrameNoise, reference: int, current: int, start: Array, end: Array) -> DisparityMap:
    u, v = (end - start + noise.at(current, end) - noise.at(reference, start)).T
    sigma, ones = np.full(GRID.shape, NOISE_PX), np.ones(GRID.shape)
    u, v = (np.ascontiguousarray(part.reshape(GRID.shape)) for part in (u, v))
    return DisparityMap(reference, current, GRID, u, v, sigma, sigma, ones, np.zeros(GRID.shape, np.uint8))


def _true_strain_per_px(amplitude_px: float, length_px: float) -> float:
    """Largest false strain along x of a gauge per px of shift, mean over a shift of 4 px to both sides."""
    centre = np.linspace(GRID.x_px[0] + 0.5 * GAUGE_PX + 4.0, GRID.x_px[-1] - 0.5 * GAUGE_PX - 4.0, 200)
    shifted = [
        [_distortion(centre + end * 0.5 * GAUGE_PX + shift, amplitude_px, length_px) for shift in (4.0, -4.0)] for end in (1.0, -1.0)
    ]
    change = [(there - back) / 8.0 for there, back in shifted]
    return float(np.abs((change[0] - change[1]) / GAUGE_PX).max())


@pytest.mark.parametrize(("amplitude_px", "length_px"), [(1.2, 15.0), (-2.0, 25.0)])
def test_a_settling_has_its_size_length_and_strain(amplitude_px: float, length_px: float) -> None:
    draws = _draws(amplitude_px, length_px, seed=1)
    assert draws.settling is not None
    assert draws.settling.amplitude_px[0] == pytest.approx(amplitude_px, rel=0.15)
    assert draws.settling.amplitude_px[1] == pytest.approx(0.0, abs=0.05)
    assert draws.settling.length_px == pytest.approx(length_px, rel=0.15)
    _, low, high = draws.strain_per_px
    assert low <= _true_strain_per_px(amplitude_px, length_px) <= high


def test_a_smooth_distortion_has_no_settling() -> None:
    draws = _draws(0.0, 20.0, seed=2)
    assert draws.settling is None
    assert draws.strain_per_px[1] <= _true_strain_per_px(0.0, 20.0) <= draws.strain_per_px[2]
