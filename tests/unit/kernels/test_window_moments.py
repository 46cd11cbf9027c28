"""Moments over windows, against sums of products."""

import numpy as np
import pytest

from semlive.kernels.window_moments import powers, window_moments

VALUE = np.random.default_rng(4).normal(size=(7, 9))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_moments_are_sums_of_products_over_the_window(order):
    found = window_moments(VALUE, 2, order)
    for moment, (a, b) in zip(found, powers(order), strict=True):
        for j, i in np.ndindex(VALUE.shape):
            rows, columns = np.mgrid[max(j - 2, 0) : min(j + 3, 7), max(i - 2, 0) : min(i + 3, 9)]
            expected = np.sum(VALUE[rows, columns] * (columns - i) ** a * (rows - j) ** b)
            assert moment[j, i] == pytest.approx(expected, abs=1e-12)


def test_a_window_larger_than_the_grid_sums_all_of_it():
    np.testing.assert_allclose(window_moments(VALUE, 20, 0)[0], np.full(VALUE.shape, VALUE.sum()))


def test_another_type_is_refused():
    with pytest.raises(ValueError, match="value must be float64"):
        window_moments(VALUE.astype(np.float32), 2, 1)
