"""Scatter of neighbouring points against the stated uncertainty."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.dic.bands.correlation import correlate_tiled
from semlive.dic.bands.image_pair import bands as bands_of
from semlive.dic.neighbour_scatter import scatter_ratio, scatters, widened
from semlive.dic.second_estimate import SecondEstimates

GRID = dic.Grid(x0_px=40, y0_px=40, step_px=5, nx=60, ny=50, subset_px=31)
SETTINGS = dic.DicSettings(subset_px=31, step_px=5, roi_px=None)
ALL = np.ones(GRID.shape, dtype=bool)


def moving_mean(pixels, grid=GRID):
    """Mean of white noise over the subset of each point, standard deviation 1."""
    smooth = cv2.boxFilter(pixels, -1, (grid.subset_px, grid.subset_px), normalize=False) / grid.subset_px
    rows, columns = (np.asarray(axis, dtype=int) for axis in (grid.y_px, grid.x_px))
    return smooth[np.ix_(rows, columns)]


def noise(seed, shape=(330, 380)):
    return np.random.default_rng(seed).standard_normal(shape)


def a_map(u, v, sigma=0.02):
    s = np.full(GRID.shape, sigma)
    zero = np.zeros(GRID.shape)
    return DisparityMap(0, 1, GRID, u, v, s, s, zero + 0.99, np.full(GRID.shape, PoiStatus.CONVERGED, np.uint8), zero)


def bands(size_px):
    """Estimates of two bands that differ by plus and minus a size in u."""
    difference = np.zeros((2, *GRID.shape, 2))
    difference[0, ..., 0], difference[1, ..., 0] = size_px, -size_px
    return SecondEstimates(difference, np.ones((2, *GRID.shape), dtype=bool))


@pytest.mark.parametrize("sigma", [0.02, 0.01])
def test_scatter_of_white_noise_in_overlapping_subsets_is_the_stated_one(sigma):
    y, x = np.mgrid[: GRID.ny, : GRID.nx]
    smooth = 1e-3 * x + 2.0 * np.sin(y / 60.0)
    values = smooth + sigma * moving_mean(noise(1))
    assert scatter_ratio(values, np.full(GRID.shape, sigma), ALL, GRID, 1) == pytest.approx(1.0, abs=0.12)


def test_scatter_of_rows_is_found_along_the_columns():
    grid, pixels = replace(GRID, ny=250), (1330, 380)
    rows = np.repeat(noise(2, (pixels[0], 1)), pixels[1], axis=1)  # one value for each row: the mean over a subset is that over its rows
    values = 0.02 * moving_mean(noise(1, pixels), grid) + 0.04 * moving_mean(rows, grid) / np.sqrt(grid.subset_px)
    all_points = np.ones(grid.shape, dtype=bool)
    assert scatter_ratio(values, np.full(grid.shape, 0.02), all_points, grid, 1) == pytest.approx(5.0**0.5, rel=0.25)


@pytest.mark.parametrize("period_px", [17.0, 33.0, 66.0])
def test_a_wave_of_one_period_is_no_scatter(period_px):
    """The spline's own bias under uniform strain is a wave: 17 px at 6 % of strain, 66 px at 1.5 %."""
    x = GRID.x_px[None, :] + 0.0 * GRID.y_px[:, None]
    wave = 0.02 * np.sin(2.0 * np.pi * x / period_px)
    assert not scatters(a_map(0.02 * moving_mean(noise(1)) + wave, 0.02 * moving_mean(noise(2))), SETTINGS)


def test_few_points_determine_no_scatter():
    valid = ALL.copy()
    valid[:, 5:] = False
    assert scatter_ratio(noise(1, GRID.shape), np.full(GRID.shape, 1e-3), valid, GRID, 1) == pytest.approx(
        scatter_ratio(noise(1, GRID.shape)[:, :5], np.full((50, 5), 1e-3), ALL[:, :5], replace(GRID, nx=5), 1)
    )
    valid[20:] = False
    assert scatter_ratio(noise(1, GRID.shape), np.full(GRID.shape, 1e-3), valid, GRID, 1) == 0.0


def test_a_map_scatters_if_the_excess_is_large_in_sigma_and_in_px():
    white = moving_mean(noise(1)), moving_mean(noise(2))
    assert not scatters(a_map(0.02 * white[0], 0.02 * white[1]), SETTINGS)
    assert scatters(a_map(0.05 * white[0], 0.02 * white[1]), SETTINGS)
    assert scatters(a_map(0.02 * white[0], 0.05 * white[1]), SETTINGS)
    assert not scatters(a_map(0.005 * white[0], 0.002 * white[1], 0.002), SETTINGS)  # 5 um of a pixel more than noise


def test_wider_uncertainties_cover_scatter_and_bands():
    u, v = 0.06 * moving_mean(noise(1)), 0.02 * moving_mean(noise(2))
    m = a_map(u, v)
    scattered = widened(m, bands(0.0), SETTINGS)
    assert np.allclose(scattered.sigma_u_px, 0.06, rtol=0.15)
    assert np.allclose(scattered.sigma_v_px, 0.02, rtol=0.15)
    displaced = widened(m, bands(0.1), SETTINGS)
    assert np.allclose(displaced.sigma_u_px, np.sqrt(0.02**2 + 2.5 * (0.1**2 - 0.5 * 0.02**2)))
    assert np.array_equal(displaced.u_px, m.u_px)


def rows_shifted(image, shift_px):
    """Each row of a periodic image shifted along x."""
    phase = np.exp(-2j * np.pi * np.fft.rfftfreq(image.shape[1]) * shift_px[:, None])
    return np.fft.irfft(np.fft.rfft(image, axis=1) * phase, n=image.shape[1], axis=1)


def test_coverage_with_shifted_rows():
    pattern = cv2.GaussianBlur(np.tile(noise(3, (256, 256)), (2, 2)), (0, 0), 2.0)[100:356, 100:356]
    pattern = 128.0 + 30.0 * pattern / pattern.std()
    rng = np.random.default_rng(4)
    frames = [rows_shifted(pattern, 0.3 * rng.standard_normal(256)) + 2.0 * rng.standard_normal((256, 256)) for _ in range(2)]
    first, second = (np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in frames)
    m = dic.match(first, second, settings=SETTINGS)
    assert m.method == "subset"
    assert m.valid.mean() > 0.9
    in_bands = correlate_tiled(first, second, m.grid, SETTINGS, band_px=60_000)
    assert len(list(bands_of(m.grid, first.shape, 60_000, 10_000))) > 1
    assert np.array_equal(in_bands.sigma_u_px, m.sigma_u_px)
    ratio = np.abs(m.u_px[m.valid] / m.sigma_u_px[m.valid])
    assert np.mean(ratio < 3.0) > 0.97
    assert 0.5 < np.mean(ratio < 1.0) < 0.9
