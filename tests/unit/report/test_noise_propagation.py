"""The propagation of DIC noise against noise that is drawn pixel by pixel and put through the product's own strain filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from semlive import mechanics
from semlive.data.grid import Grid
from semlive.data.strain import Displacement
from semlive.report.noise_propagation import effective_sample_size, noise_scatter

GRID = Grid(30, 30, 5, 60, 48, 21)
SIGMA_U_PX, SIGMA_V_PX = 0.02, 0.03


def noisy(rng: np.random.Generator) -> Displacement:
    """White noise of pixels averaged over each POI's subset, scaled to the wanted standard deviation."""
    fields = []
    for sigma_px in (SIGMA_U_PX, SIGMA_V_PX):
        pixels = rng.normal(size=(GRID.y0_px + 5 * GRID.ny + 30, GRID.x0_px + 5 * GRID.nx + 30))
        smooth = uniform_filter(pixels, GRID.subset_px, mode="wrap") * GRID.subset_px * sigma_px
        fields.append(np.ascontiguousarray(smooth[30 : 30 + 5 * GRID.ny : 5, 30 : 30 + 5 * GRID.nx : 5]))
    item = np.ones(GRID.shape)
    return Displacement(1, GRID, fields[0], fields[1], SIGMA_U_PX * item, SIGMA_V_PX * item, item.astype(bool))


@pytest.mark.parametrize("full", [True, False])
def test_the_scatter_of_strain_is_predicted(full: bool) -> None:
    rng = np.random.default_rng(5)
    drawn = [noisy(rng) for _ in range(40)]
    for points in (3, 9, 21):
        expected, half = noise_scatter(GRID, points, SIGMA_U_PX, SIGMA_V_PX, full=full), points // 2
        found: dict[str, list[float]] = {"exx": [], "eyy": [], "exy": []}
        for item in drawn:
            field = mechanics.strain(item, points)
            part = (slice(half, GRID.ny - half), slice(half, GRID.nx - half)) if full else (slice(None), slice(None))
            assert field.valid.all()
            for name, values in found.items():
                values.append(float(np.var(getattr(field, name)[part])))
        chance = 3 / np.sqrt(2 * len(drawn) * effective_sample_size(GRID, points))
        for name, values in found.items():
            assert np.sqrt(np.mean(values)) / getattr(expected, name) == pytest.approx(1.0, abs=max(0.02, chance)), (points, name)


def test_single_points_scatter_as_stated_but_for_their_own_mean() -> None:
    alone = noise_scatter(GRID, 1, SIGMA_U_PX, SIGMA_V_PX, full=True)
    shared = (GRID.subset_px / GRID.step_px) ** 2 / (GRID.nx * GRID.ny)
    assert alone.u == pytest.approx(SIGMA_U_PX * np.sqrt(1 - shared), rel=0.01)
    assert alone.v / alone.u == pytest.approx(1.5)


def test_points_whose_subsets_do_not_touch_are_independent() -> None:
    wide = Grid(30, 30, 21, 12, 10, 21)
    assert effective_sample_size(wide) == pytest.approx(120.0)
    white = noise_scatter(wide, 3, 0.02, 0.02, full=True)
    assert white.exx == pytest.approx(0.02 / (21 * np.sqrt(6)), rel=0.02)
