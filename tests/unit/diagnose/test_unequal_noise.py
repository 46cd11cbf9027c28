"""Whitening of noise that differs between frames and is shared by pairs, against dense matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_triangular

from semlive.data.grid import Grid
from semlive.diagnose.baseline.whitening import Whitener, Window, make_whitener
from semlive.diagnose.maps.parameter_search import posterior_moments

GRID, FRAMES, SIGMA_PX = Grid(0, 0, 20, 12, 9, 43), 8, 0.02


@pytest.fixture(scope="module")
def equal() -> Whitener:
    return make_whitener(GRID, np.arange(12), Window(43.0), SIGMA_PX)


@pytest.fixture(scope="module")
def covariance() -> np.ndarray:
    """Of the frames: sizes of their own, and pairs after the first that share a half."""
    size = np.array([1.0, 1.0, 0.5, 2.0, 1.0, 1.5, 0.7, 1.2])
    shared = np.eye(FRAMES)
    for first in range(2, FRAMES, 2):
        shared[first, first + 1] = shared[first + 1, first] = 0.5
    return size[:, None] * shared * size


@pytest.fixture(scope="module")
def unequal(equal: Whitener, covariance: np.ndarray) -> Whitener:
    inverse = solve_triangular(np.linalg.cholesky(covariance), np.eye(FRAMES), lower=True)
    return replace(equal, over_frames=(inverse, inverse))


def test_frames_of_equal_noise_are_whitened_as_without_sizes(equal: Whitener) -> None:
    same = replace(equal, over_frames=(np.eye(FRAMES), np.eye(FRAMES)))
    field = np.random.default_rng(1).normal(size=(FRAMES, 12, 2, 3))
    np.testing.assert_allclose(same(field), equal(field), atol=1e-9)
    np.testing.assert_allclose(
        same.rows(1, np.ascontiguousarray(field[:, :, 1].transpose(2, 0, 1))), equal(field)[:, :, 1].transpose(2, 0, 1), atol=1e-9
    )
    assert same.half_log_det == pytest.approx(0.0)


def test_a_displacement_equal_in_all_frames_is_not_observable(unequal: Whitener) -> None:
    place = np.random.default_rng(2).normal(size=(1, 12, 2))
    np.testing.assert_allclose(unequal(np.repeat(place, FRAMES, axis=0)), 0.0, atol=1e-9)


@pytest.mark.parametrize("noise", ["equal", "unequal"])
def test_products_with_whitened_fields_are_those_of_fields_with_the_adjoint(noise: str, request: pytest.FixtureRequest) -> None:
    whiten: Whitener = request.getfixturevalue(noise)
    rng = np.random.default_rng(4)
    fields, others = rng.normal(size=(3, FRAMES, 12)), rng.normal(size=(FRAMES * 12, 2))
    for axis in (0, 1):
        whitened = whiten.rows(axis, fields).reshape(3, -1) @ others
        np.testing.assert_allclose(fields.reshape(3, -1) @ whiten.adjoint(axis, others), whitened, atol=1e-9 * np.abs(whitened).max())


def test_power_and_volume_are_those_of_the_dense_likelihood(equal: Whitener, unequal: Whitener, covariance: np.ndarray) -> None:
    """Log likelihood of one component with the reference address of each block free, relative to equal noise."""
    field = np.zeros((FRAMES, 12, 2))
    field[:, :, 0] = SIGMA_PX * np.random.default_rng(3).normal(size=(FRAMES, 12))
    blocks = SIGMA_PX**2 * equal.factor @ equal.factor.T
    # Differences to frame 0 do not contain the reference address.
    difference = np.hstack((-np.ones((FRAMES - 1, 1)), np.eye(FRAMES - 1)))

    def dense(frames: np.ndarray) -> float:
        total = np.kron(difference @ frames @ difference.T, blocks)
        data = (difference @ field[:, :, 0]).ravel()
        return float(-0.5 * data @ np.linalg.solve(total, data) - 0.5 * np.linalg.slogdet(total)[1])

    gain = -0.5 * float(np.sum(unequal(field) ** 2) - np.sum(equal(field) ** 2)) - 0.5 * unequal.half_log_det  # two components in it
    assert gain == pytest.approx(dense(covariance) - dense(np.eye(FRAMES)), abs=1e-6)


def test_a_posterior_far_above_its_start_has_finite_moments() -> None:
    moments = posterior_moments([0.0, 2000.0, 1999.0], [np.zeros(2), np.array([2.0, 1.0]), np.array([3.0, 1.0])])
    assert 2.0 < moments[0, 0] ** 0.5 < 3.0
    assert moments[1, 1] == pytest.approx(1.0)
