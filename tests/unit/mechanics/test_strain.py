"""Virtual strain gauge, summary and elastic constants."""

from __future__ import annotations

import numpy as np
import pytest

from semlive import mechanics
from semlive.data.grid import Grid
from semlive.data.strain import Displacement, StrainSummary, Tensor2
from semlive.errors import IllPosed

GRID = Grid(50, 60, 5, 24, 20, 43)
RNG = np.random.default_rng(11)


def moved(u: np.ndarray, v: np.ndarray, valid: np.ndarray | None = None) -> Displacement:
    mask = np.ones(GRID.shape, bool) if valid is None else valid
    sigma = np.full(GRID.shape, 0.02)
    return Displacement(6, GRID, np.where(mask, u, 0.0), np.where(mask, v, 0.0), sigma, sigma, mask)


def brute_force(one: Displacement, window: int, iy: int, ix: int) -> tuple[float, float, float]:
    half = window // 2
    rows, columns = slice(max(iy - half, 0), iy + half + 1), slice(max(ix - half, 0), ix + half + 1)
    x, y = one.grid.mesh()
    use = one.valid[rows, columns]
    plane = np.column_stack((np.ones(use.sum()), x[rows, columns][use], y[rows, columns][use]))
    (_, ux, uy), (_, vx, vy) = (np.linalg.lstsq(plane, f[rows, columns][use], rcond=None)[0] for f in (one.u_px, one.v_px))
    return ux, vy, 0.5 * (uy + vx)


@pytest.mark.parametrize("window", [3, 5, 9])
def test_gauge_is_a_plane_fit_with_masks_and_edges(window: int) -> None:
    mask = RNG.random(GRID.shape) > 0.15
    one = moved(RNG.normal(size=GRID.shape), RNG.normal(size=GRID.shape), mask)
    field = mechanics.strain(one, window)
    assert field.valid.mean() > 0.5
    assert not field.valid[~mask].any()
    for iy, ix in np.argwhere(field.valid)[::7]:
        printed = field.exx[iy, ix], field.eyy[iy, ix], field.exy[iy, ix]
        np.testing.assert_allclose(printed, brute_force(one, window, iy, ix), rtol=1e-9, atol=1e-12)
    assert not field.exx[~field.valid].any()


def test_thin_and_empty_windows_are_not_valid() -> None:
    mask = np.zeros(GRID.shape, bool)
    mask[10, :] = True
    assert not mechanics.strain(moved(np.ones(GRID.shape), np.ones(GRID.shape), mask), 5).valid.any()


@pytest.mark.parametrize("window", [1, 4, 25])
def test_window_must_fit(window: int) -> None:
    with pytest.raises(IllPosed, match="odd number"):
        mechanics.strain(moved(np.zeros(GRID.shape), np.zeros(GRID.shape)), window)


def test_mean_of_nothing_is_refused() -> None:
    one = moved(np.zeros(GRID.shape), np.zeros(GRID.shape), np.zeros(GRID.shape, bool))
    field = mechanics.strain(one, 3)
    with pytest.raises(IllPosed, match="frame 6"):
        mechanics.summary(one, field)


def test_sigma_of_the_mean_counts_independent_points() -> None:
    """Paper's grid: sigma sqrt(12 / 272) / L, with L the extent of the grid."""
    grid = Grid(101, 101, 5, 150, 120, 43)
    sigma, zero = np.full(grid.shape, 0.02), np.zeros(grid.shape)
    one = Displacement(2, grid, zero, zero, sigma, sigma, np.ones(grid.shape, bool))
    printed = mechanics.summary(one, mechanics.strain(one, 9), systematic=Tensor2(0.0, 3e-5, 0.0))
    n_eff = 150 * 120 * (5 / 43) ** 2
    assert printed.mean_sigma.exx == pytest.approx(0.02 * np.sqrt(12 / n_eff) / 750, rel=1e-3)
    assert printed.mean_sigma.eyy == pytest.approx(np.hypot(0.02 * np.sqrt(12 / n_eff) / 600, 3e-5), rel=1e-3)


def loaded(load_n: float, axial: float, transverse: float, sigma: float) -> tuple[float, StrainSummary]:
    each = Tensor2(sigma, sigma, sigma)
    return load_n, StrainSummary(0, Tensor2(transverse, axial, 0.0), each, each, 83.0)


def test_elastic_constants_with_a_zero_offset_and_noise() -> None:
    """E and Poisson's ratio cover the truth as often as their sigmas predict; an offset of strain changes nothing."""
    loads, sigma, load_sigma = np.repeat(np.linspace(0, 2200, 7), 2), 1e-5, 3.0
    z = []
    for _ in range(300):
        noise = RNG.normal(0, sigma, (2, len(loads)))
        stress = loads / 10.0
        printed = loads + RNG.normal(0, load_sigma, len(loads))
        points = [
            loaded(f, s / 71.1e3 + a + 5e-5, -0.33 * s / 71.1e3 + t, sigma) for f, s, a, t in zip(printed, stress, *noise, strict=True)
        ]
        found = mechanics.elastic_constants(points, 10.0, "y", load_sigma)
        youngs, ratio = found.youngs_modulus_gpa, found.poissons_ratio
        z.append([(youngs.value - 71.1) / youngs.sigma, (ratio.value - 0.33) / ratio.sigma])
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.9) & (rms < 1.1)), rms


def test_errors_that_grow_with_load_are_counted() -> None:
    points = [loaded(f, f / 711e3, -0.33 * f / 711e3, 1e-6) for f in (0.0, 1000.0, 2000.0)]
    common = np.zeros((6, 6))
    common[3:, 3:] = np.outer([0, 1, 2], [0, 1, 2]) * 1e-10  # eyy of the three frames: 1e-5 per 1000 N
    found = mechanics.elastic_constants(points, 10.0, "y", covariance=common)
    assert found.youngs_modulus_gpa.sigma / found.youngs_modulus_gpa.value == pytest.approx(1e-5 * 711, rel=1e-6)


def test_loading_axis_x() -> None:
    points = [
        (f, StrainSummary(0, Tensor2(f / 711e3, -0.3 * f / 711e3, 0.0), *(Tensor2(1e-6, 1e-6, 1e-6),) * 2, 83.0)) for f in (0.0, 900.0)
    ]
    found = mechanics.elastic_constants(points, 10.0, "x")
    assert found.youngs_modulus_gpa.value == pytest.approx(71.1)
    assert found.poissons_ratio.value == pytest.approx(0.3)


@pytest.mark.parametrize("points", [[], [loaded(100.0, 1e-3, 0.0, 1e-6)], [loaded(100.0, 1e-3, 0.0, 1e-6)] * 4])
def test_one_load_gives_no_modulus(points: list[tuple[float, StrainSummary]]) -> None:
    with pytest.raises(IllPosed, match="two or more different loads"):
        mechanics.elastic_constants(points, 10.0)


def test_strain_against_stress_is_refused() -> None:
    with pytest.raises(IllPosed, match="sign of the load"):
        mechanics.elastic_constants([loaded(0.0, 0.0, 0.0, 1e-6), loaded(100.0, -1e-3, 0.0, 1e-6)], 10.0)
