"""Options of the virtual strain gauge against brute force and exact fields."""

from __future__ import annotations

import numpy as np
import pytest

from semlive import mechanics
from semlive.data.grid import Grid
from semlive.data.settings import StrainSettings
from semlive.data.strain import Displacement
from semlive.errors import IllPosed

GRID = Grid(50, 60, 5, 24, 20, 43)


def moved(u: np.ndarray, v: np.ndarray, valid: np.ndarray | None = None) -> Displacement:
    mask = np.ones(GRID.shape, bool) if valid is None else valid
    sigma = np.full(GRID.shape, 0.02)
    return Displacement(6, GRID, np.where(mask, u, 0.0), np.where(mask, v, 0.0), sigma, sigma, mask)


def noisy(seed: int, holes: float = 0.15) -> Displacement:
    rng = np.random.default_rng(seed)
    return moved(rng.normal(size=GRID.shape), rng.normal(size=GRID.shape), rng.random(GRID.shape) >= holes)


def brute_force(one: Displacement, window: int, at: tuple[int, int], order: int, gaussian: bool) -> tuple[float, float, float]:
    half, (iy, ix) = window // 2, at
    rows, columns = slice(max(iy - half, 0), iy + half + 1), slice(max(ix - half, 0), ix + half + 1)
    x, y = one.grid.mesh()
    use = one.valid[rows, columns]
    dx, dy = (x[rows, columns] - x[at])[use], (y[rows, columns] - y[at])[use]
    terms = [np.ones_like(dx), dx, dy] + ([dx * dx, dx * dy, dy * dy] if order == 2 else [])
    sd = 0.5 * half * one.grid.step_px
    root = np.exp(-0.25 * (dx**2 + dy**2) / sd**2) if gaussian else np.ones_like(dx)
    fit = [
        np.linalg.lstsq(np.stack(terms, axis=1) * root[:, None], f[rows, columns][use] * root, rcond=None)[0] for f in (one.u_px, one.v_px)
    ]
    return fit[0][1], fit[1][2], 0.5 * (fit[0][2] + fit[1][1])


def test_the_defaults_are_the_plane_over_a_square() -> None:
    one = noisy(1)
    a, b = mechanics.strain(one, 5), mechanics.strain_field(one, 5, StrainSettings())
    for name in ("exx", "eyy", "exy", "valid"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("weights", ["uniform", "gaussian"])
def test_orders_and_weights_with_masks_and_edges(order: int, weights: str) -> None:
    one, gaussian = noisy(2), weights == "gaussian"
    field = mechanics.strain_field(
        one, 7, StrainSettings(order=order, weights="gaussian" if gaussian else "uniform", butterworth_points=None)
    )
    assert field.valid.mean() > 0.5
    for iy, ix in np.argwhere(field.valid)[::17]:
        expected = brute_force(one, 7, (int(iy), int(ix)), order, gaussian)
        assert (field.exx[iy, ix], field.eyy[iy, ix], field.exy[iy, ix]) == pytest.approx(expected, abs=1e-9)


def test_second_order_is_exact_at_edges_where_strain_varies() -> None:
    x, y = GRID.mesh()
    one = moved(1e-5 * (x - 100) ** 2, 2e-5 * (y - 90) * (x - 60))
    plane, bent = (mechanics.strain_field(one, 9, StrainSettings(order=order, weights="gaussian")) for order in (1, 2))
    truth = 2e-5 * (x - 100)
    assert np.abs(bent.exx - truth)[bent.valid].max() < 1e-12
    assert np.abs(plane.exx - truth)[:, 0].max() > 1e-4
    assert bent.valid[:, 0].all()


def test_green_lagrange_strain_of_a_rotation_is_zero() -> None:
    x, y = GRID.mesh()
    c, s = np.cos(0.03), np.sin(0.03)
    one = moved((c - 1) * x - s * y, s * x + (c - 1) * y)
    green, small = (mechanics.strain_field(one, 5, StrainSettings(measure=name)) for name in ("green_lagrange", "engineering"))
    assert max(np.abs(part).max() for part in (green.exx, green.eyy, green.exy)) < 1e-12
    assert small.exx.mean() == pytest.approx(c - 1)
    stretched = mechanics.strain_field(moved(0.02 * x, -0.01 * y), 5, StrainSettings(measure="green_lagrange"))
    assert stretched.exx.mean() == pytest.approx(0.02 + 0.5 * 0.02**2)


def test_the_filter_passes_uniform_strain_and_cuts_noise() -> None:
    x, y = GRID.mesh()
    rng = np.random.default_rng(4)
    mask = rng.random(GRID.shape) > 0.05
    exact = mechanics.strain_field(moved(2e-3 * x + 1e-3 * y, -1e-3 * y, mask), 5, StrainSettings(butterworth_points=12.0))
    assert np.abs(exact.exx[exact.valid] - 2e-3).max() < 1e-12
    noise = moved(rng.normal(0, 0.02, GRID.shape), rng.normal(0, 0.02, GRID.shape))
    raw, cut = (mechanics.strain_field(noise, 5, StrainSettings(butterworth_points=points)) for points in (None, 12.0))
    assert cut.exx.std() < 0.5 * raw.exx.std()
    wave = np.cos(np.pi * (np.arange(GRID.nx) + 0.5) * 4 / GRID.nx) * np.ones(GRID.shape)  # two periods of 12 points
    assert np.ptp(mechanics.butterworth(moved(wave, wave), 12.0).u_px) / np.ptp(wave) == pytest.approx(0.5**0.5, rel=0.02)
    with pytest.raises(IllPosed, match="cuts at nothing"):
        mechanics.butterworth(noise, 1.0)


def test_noise_falls_as_the_square_of_the_gage() -> None:
    """White noise: sd of a slope over n x n points goes as n^-2."""
    rng = np.random.default_rng(5)
    x, _ = GRID.mesh()
    curve = mechanics.noise_curve(moved(1e-3 * x + rng.normal(0, 0.02, GRID.shape), rng.normal(0, 0.02, GRID.shape)), (3, 5, 9, 99))
    assert [one.window_points for one in curve] == [3, 5, 9]
    assert [one.vsg_px for one in curve] == sorted(one.vsg_px for one in curve)
    for one in curve[:2]:
        n = one.window_points
        assert one.sd.exx == pytest.approx(0.02 / 5 * np.sqrt(12 / (n**2 * (n**2 - 1))), rel=0.35)
