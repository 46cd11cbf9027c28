"""The stated uncertainty of one virtual strain gauge."""

from __future__ import annotations

import numpy as np
import pytest

from semlive import mechanics
from semlive.data.grid import Grid
from semlive.data.settings import StrainSettings
from semlive.data.strain import Displacement, Tensor2
from semlive.mechanics.strain_gauge_fits import gradients, whole_window

GRID = Grid(30, 30, 5, 60, 50, 21)
SIGMA_U_PX, SIGMA_V_PX = 0.02, 0.03
RNG = np.random.default_rng(8)


def noisy() -> Displacement:
    """Noise of subsets that overlap: means of white noise over a subset's pixels."""
    ny, nx = (GRID.ny - 1) * GRID.step_px + GRID.subset_px, (GRID.nx - 1) * GRID.step_px + GRID.subset_px
    total = np.pad(RNG.normal(size=(2, ny, nx)), ((0, 0), (1, 0), (1, 0))).cumsum(axis=1).cumsum(axis=2)
    n, s = GRID.subset_px, GRID.step_px
    boxes = total[:, n:, n:] - total[:, :-n, n:] - total[:, n:, :-n] + total[:, :-n, :-n]
    u, v = boxes[:, ::s, ::s] / n * np.array([SIGMA_U_PX, SIGMA_V_PX])[:, None, None]
    sigma_u, sigma_v = (np.full(GRID.shape, item) for item in (SIGMA_U_PX, SIGMA_V_PX))
    return Displacement(1, GRID, u, v, sigma_u, sigma_v, np.ones(GRID.shape, dtype=np.bool_))


@pytest.mark.parametrize("settings", [StrainSettings(), StrainSettings(order=2), StrainSettings(weights="gaussian")])
def test_gauges_scatter_as_stated(settings: StrainSettings) -> None:
    square, printed = [], None
    for _ in range(12):
        field = mechanics.strain_field(moved := noisy(), 9, settings)
        printed = mechanics.summary(moved, field, settings=settings).gauge_sigma
        square.append([np.mean(item[4:-4, 4:-4] ** 2) for item in (field.exx, field.eyy, field.exy)])
    assert printed is not None
    # A field is worth some 60 independent gauges, twelve know the scatter to 3 %.
    assert np.sqrt(np.mean(square, axis=0)) == pytest.approx([printed.exx, printed.eyy, printed.exy], rel=0.12)


def test_what_the_correction_adds_is_in_it_and_a_filtered_gauge_states_nothing() -> None:
    moved = noisy()
    field = mechanics.strain(moved, 9)
    alone = mechanics.summary(moved, field).gauge_sigma
    more = mechanics.summary(moved, field, systematic=Tensor2(0.0, 1e-3, 0.0)).gauge_sigma
    assert alone is not None
    assert more is not None
    assert more.exx == alone.exx
    assert more.eyy == pytest.approx(float(np.hypot(alone.eyy, 1e-3)))
    filtered = StrainSettings(butterworth_points=11.0)
    assert mechanics.summary(moved, mechanics.strain_field(moved, 9, filtered), settings=filtered).gauge_sigma is None


@pytest.mark.parametrize("settings", [StrainSettings(), StrainSettings(order=2), StrainSettings(order=2, weights="gaussian")])
def test_the_weights_of_a_complete_window_are_those_of_the_fit(settings: StrainSettings) -> None:
    moved = noisy()
    (ux, uy, _, _), _ = gradients(moved, 7, settings)
    cut = moved.u_px[10:17, 20:27]
    assert (np.sum(whole_window(7, settings) * cut, axis=(1, 2)) / GRID.step_px) == pytest.approx([ux[13, 23], uy[13, 23]], abs=1e-12)
