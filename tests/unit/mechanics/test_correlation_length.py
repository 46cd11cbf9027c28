"""Correlation of an engine's noise, estimated from maps of known noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.mechanics.correlation_length import correlation_of, window_correlation

STEP_PX, SIZE_PX = 16, 640
WINDOWS = {
    "square": (lambda white: uniform_filter(white, 43, mode="wrap"), 43.0),
    # Weights exp(-r^2 / 2 s^2) have the correlation exp(-r^2 / 4 s^2), whose area is 4 pi s^2.
    "gaussian": (lambda white: gaussian_filter(white, 9.0, mode="wrap"), np.sqrt(4.0 * np.pi) * 9.0),
}


def maps(window: object, lost: float = 0.0, sigma_px: float = 0.02, drift_px: float = 0.0, count: int = 2) -> list[DisparityMap]:
    """Maps of noise seen through a window, with a smooth field, and with drift that differs from row to row."""
    rng, points = np.random.default_rng(5), np.arange(40, SIZE_PX - 40, STEP_PX)
    grid = Grid(40, 40, STEP_PX, len(points), len(points), 0)
    x, y = grid.mesh()
    made = []
    for number in range(count):
        fields = []
        for _ in range(2):
            noise = window(rng.normal(size=(SIZE_PX, SIZE_PX)))  # type: ignore[operator]
            rows = drift_px * np.cumsum(rng.normal(size=len(points)))[:, None]
            fields.append(sigma_px * (noise / noise.std())[np.ix_(points, points)] + 0.3 * (y / SIZE_PX) ** 2 - 1e-3 * x + rows)
        valid = rng.uniform(size=x.shape) >= lost
        status = np.where(valid, PoiStatus.CONVERGED, PoiStatus.LOW_ZNCC).astype(np.uint8)
        sigma = np.full(x.shape, sigma_px)
        u, v = fields
        made.append(DisparityMap(2 * number, 2 * number + 1, grid, u, v, sigma, sigma, valid.astype(float), status))
    return made


@pytest.mark.parametrize("name", WINDOWS)
def test_edge_and_noise_of_a_window_are_found(name: str) -> None:
    window, edge_px = WINDOWS[name]
    found = correlation_of(maps(window))
    assert found is not None
    assert found.edge_px == pytest.approx(edge_px, rel=0.15)
    assert found.sigma_px == pytest.approx((0.02, 0.02), rel=0.15)
    assert found.subset_px % 2 == 1


def test_a_window_that_fits_few_times_into_the_field_is_not_underestimated() -> None:
    """The polynomial that removes drift follows the noise of such a window: without a correction 86 px and 0.018 px were found."""
    found = correlation_of(maps(lambda white: gaussian_filter(white, 28.0, mode="wrap"), count=24))
    assert found is not None
    assert found.edge_px == pytest.approx(np.sqrt(4.0 * np.pi) * 28.0, rel=0.06)
    assert found.sigma_px == pytest.approx((0.02, 0.02), rel=0.03)


def test_independent_points_are_recognised() -> None:
    found = correlation_of(maps(lambda white: white))
    assert found is not None
    assert (found.subset_px, found.own_fraction) == (0, 1.0)


def test_lost_points_do_not_matter() -> None:
    found = correlation_of(maps(WINDOWS["square"][0], lost=0.3))
    assert found is not None
    assert found.edge_px == pytest.approx(43.0, rel=0.15)


def test_drift_from_row_to_row_is_no_correlation() -> None:
    found = correlation_of(maps(WINDOWS["square"][0], drift_px=0.003))
    assert found is not None
    assert found.edge_px == pytest.approx(43.0, rel=0.2)


def test_maps_without_noise_give_no_correlation_length() -> None:
    assert correlation_of(maps(WINDOWS["square"][0], sigma_px=1e-6)) is None


@pytest.mark.parametrize("gaussian", [0.0, 0.2, 0.45, 1.0])
def test_every_window_has_the_area_of_its_edge(gaussian: float) -> None:
    distance_px = np.arange(-400.0, 400.5, 0.5)
    correlation = window_correlation(distance_px, 43.0, gaussian)
    assert correlation.max() == pytest.approx(1.0)
    assert 0.5 * correlation.sum() == pytest.approx(43.0, rel=1e-3)
