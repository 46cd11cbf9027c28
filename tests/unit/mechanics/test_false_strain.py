"""False strain of a translated, uncorrected image against the gradients of a known distortion."""

from __future__ import annotations

import numpy as np
import pytest

from semlive import mechanics
from semlive.data.drift import DistortionField
from semlive.data.grid import Grid

GRID = Grid(101, 101, 5, 80, 60, 43)


def field(ex: np.ndarray, ey: np.ndarray) -> DistortionField:
    return DistortionField(GRID, ex, ey, np.zeros(GRID.shape), np.ones(GRID.shape, dtype=np.bool_))


def test_a_quadratic_distortion_gives_uniform_false_strain() -> None:
    x, y = GRID.mesh()
    found = mechanics.false_strain(field(1e-5 * x * x, 2e-5 * x * y), (5.0, -8.0), 9)
    assert found.exx[found.valid] == pytest.approx(2e-5 * 5.0, rel=1e-3)
    assert found.eyy[found.valid] == pytest.approx(2e-5 * 5.0, rel=1e-3)
    assert found.exy[found.valid] == pytest.approx(0.5 * 2e-5 * -8.0, rel=1e-3)


def test_points_that_leave_the_calibrated_grid_are_not_valid() -> None:
    x, _ = GRID.mesh()
    found = mechanics.false_strain(field(1e-5 * x * x, 0 * x), (20.0, 0.0), 9)
    assert not found.valid[:, -4:].any()
    assert found.valid[:, :-5].all()


def test_an_affine_distortion_causes_no_apparent_strain() -> None:
    x, y = GRID.mesh()
    found = mechanics.false_strain(field(1e-3 * x, -2e-3 * y), (5.0, 5.0), 9)
    assert np.abs(found.exx[found.valid]).max() < 1e-12
