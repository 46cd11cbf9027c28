"""Single wrong points where a block is a point, which no mean of many takes out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.observing import observed

from semlive.data.grid import Grid
from semlive.estimate.joint.observations.block_means import Blocks, _least_squares, isolated_outliers

GRID = Grid(101, 101, 60, 13, 10, 43)
EVERY = np.ones(GRID.shape, dtype=np.bool_)


def smooth(rng: np.random.Generator, noise_px: float = 0.02) -> np.ndarray:
    """A map's component: what a specimen, a distortion and a drift make of it, and noise."""
    x, y = (item / 500.0 - 1.0 for item in GRID.mesh())
    bent = 4.0 * x * y**2 - 2.0 * x**3 + 3.0 * y + 0.5 * np.sin(4.0 * y) + 0.3 * np.cos(5.0 * x * y)
    return bent + rng.normal(0.0, noise_px, GRID.shape)


@pytest.mark.parametrize("noise_px", [0.0, 0.005, 0.02, 0.1])
def test_noise_and_bending_are_not_wrong(noise_px: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        assert not isolated_outliers(smooth(rng, noise_px), EVERY).any()


@pytest.mark.parametrize(
    ("place", "wrong_px"),
    [((4, 5), 0.4), ((4, 5), -30.0), ((0, 6), 0.4), ((3, 0), -0.4), ((3, 0), 30.0), ((9, 12), 1.0), ((0, 0), -1.0), ((9, 12), 30.0)],
)
def test_a_point_that_is_off_all_its_neighbours_is_wrong(place: tuple[int, int], wrong_px: float) -> None:
    value = smooth(np.random.default_rng(2))
    value[place] += wrong_px

    assert np.argwhere(isolated_outliers(value, EVERY)).tolist() == [list(place)]


@pytest.mark.parametrize("way", [(1.0, 0.0), (0.0, 1.0), (0.6, 0.8), (0.95, -0.3)])
def test_a_slip_line_or_a_jump_between_rows_is_not_wrong(way: tuple[float, float]) -> None:
    x, y = GRID.mesh()
    beyond = way[0] * (x - 440.0) + way[1] * (y - 350.0) > 0.0

    assert not isolated_outliers(smooth(np.random.default_rng(3)) + 2.0 * beyond, EVERY).any()


def test_a_point_without_a_neighbour_is_not_judged() -> None:
    value, valid = smooth(np.random.default_rng(4)), EVERY.copy()
    valid[:3, :3] = False
    valid[0, 0] = True
    value[0, 0] += 0.5

    assert not isolated_outliers(value, valid).any()
    assert not isolated_outliers(value, np.zeros_like(valid)).any()


def test_where_subsets_overlap_the_median_of_a_block_decides_as_before() -> None:
    dense = Grid(101, 101, 15, 50, 40, 43)
    value, valid = np.zeros(dense.nx * dense.ny), np.ones(dense.nx * dense.ny, dtype=np.bool_)
    value[[77, 78, 127, 128]] = 1.0  # points off together, alone in their block by number

    assert np.flatnonzero(~Blocks.of(dense).inliers(value, valid)).tolist() == [77, 78, 127, 128]


def test_one_point_in_a_thousand_wrong_changes_no_choice() -> None:
    right, wrong = (observed(Conditions(3, calibration=5, tension=3, outliers=share), (), GRID).solution.hyper for share in (0.0, 0.001))

    assert wrong.noise_scale == pytest.approx(right.noise_scale, rel=0.02)  # before, the path of the lines was let go by 3 px
    assert replace(wrong, noise_scale=right.noise_scale) == right


@pytest.mark.parametrize(("rows", "columns", "repeated"), [(180, 28, 0), (28, 28, 0), (180, 28, 3), (20, 28, 0), (0, 28, 0)])
def test_normal_equations_give_what_a_singular_value_decomposition_gives(rows: int, columns: int, repeated: int) -> None:
    rng = np.random.default_rng(5)
    design, samples = rng.standard_normal((rows, columns)), rng.standard_normal(rows)
    design[:, :repeated] = design[:, repeated : 2 * repeated]
    expected = np.linalg.lstsq(design, samples, rcond=None)[0]
    np.testing.assert_allclose(_least_squares(design, samples), expected, rtol=0.0, atol=1e-9 * np.abs(expected).max(initial=1.0))
