"""Noise of displacement and strain, in maps of two frames with white noise, row jitter or a wave that are averaged over subsets."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from semlive import mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.data.strain import Displacement
from semlive.qualify.figures.noise import displacement_scatter, rotation_sigma_rad, strain_scatter

Array = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX, SUBSET_PX, STEP_PX, WINDOW_POINTS = 512, 442, 43, 14, 5
GRID = Grid(SUBSET_PX // 2, SUBSET_PX // 2, STEP_PX, (WIDTH_PX - SUBSET_PX) // STEP_PX, (HEIGHT_PX - SUBSET_PX) // STEP_PX, SUBSET_PX)
MAPS, RUNS = 8, 10


def _field(rng: np.random.Generator, white_px: float, jitter_px: float, wave_px: float, cycles: float) -> Array:
    rows = np.sqrt(2.0) * jitter_px * rng.standard_normal((HEIGHT_PX, 1))
    phases, turned = rng.uniform(0.0, 2.0 * np.pi, 2), 2.0 * np.pi * cycles * np.arange(HEIGHT_PX)[:, None] / HEIGHT_PX
    wave = wave_px * (np.cos(turned + phases[0]) - np.cos(turned + phases[1]))
    averaged = ndimage.uniform_filter(SUBSET_PX * white_px * rng.standard_normal((HEIGHT_PX, WIDTH_PX)) + rows + wave, SUBSET_PX)
    return averaged[np.ix_(GRID.y_px.astype(int), GRID.x_px.astype(int))]


def _map(rng: np.random.Generator, *noise: float) -> DisparityMap:
    sigma = np.full(GRID.shape, 0.01)
    u_px, v_px = _field(rng, *noise), _field(rng, *noise)
    return DisparityMap(0, 1, GRID, u_px, v_px, sigma, sigma, np.ones(GRID.shape), np.zeros(GRID.shape, dtype=np.uint8))


def _strain_squares(one: DisparityMap) -> list[float]:
    moved = Displacement(0, GRID, one.u_px, one.v_px, one.sigma_u_px, one.sigma_v_px, one.valid)
    found, half = mechanics.strain(moved, WINDOW_POINTS), WINDOW_POINTS // 2
    return [float(np.mean(value[half:-half, half:-half] ** 2)) for value in (found.exx, found.eyy, found.exy)]


@pytest.mark.parametrize(
    ("noise", "tolerance"),
    [
        ((0.02, 0.0, 0.0, 0.0), 0.02),
        ((0.01, 0.15, 0.0, 0.0), 0.06),  # without the part that the trend follows: 0.83 of the displacement
        ((0.01, 0.0, 0.05, 23.2), 0.03),
        ((0.01, 0.0, 0.05, 3.4), 0.04),  # with all of that part: 1.2 of the displacement
    ],
)
def test_the_part_of_the_noise_that_the_trend_follows_is_added(noise: tuple[float, ...], tolerance: float) -> None:
    rng = np.random.default_rng(21)
    stated: list[Array] = []
    true: list[list[float]] = []
    for _ in range(RUNS):
        maps = [_map(rng, *noise) for _ in range(MAPS)]
        displacements, strains = displacement_scatter(maps), strain_scatter(maps, WINDOW_POINTS)
        assert displacements is not None
        assert strains is not None
        stated.append(np.concatenate([(found.observed + found.followed).mean(axis=0) for found in (displacements, strains)]))
        true += [[float(np.mean(one.u_px**2)), float(np.mean(one.v_px**2)), *_strain_squares(one)] for one in maps]
    np.testing.assert_allclose(np.sqrt(np.mean(stated, axis=0) / np.mean(true, axis=0)), 1.0, atol=tolerance)


def test_the_rotation_is_as_uncertain_as_its_rows() -> None:
    rng, jitter_px = np.random.default_rng(22), 0.3
    found = [rotation_sigma_rad([_map(rng, 0.005, jitter_px, 0.0, 0.0) for _ in range(MAPS)]) for _ in range(RUNS)]
    slope = np.sqrt(2.0) * jitter_px * np.sqrt(12.0) / HEIGHT_PX**1.5  # of a line fitted to all rows of the map
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(0.25 * slope, rel=0.15)
    assert rotation_sigma_rad([]) == 0.0
