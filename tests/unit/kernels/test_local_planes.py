"""Planes through trusted points, against plain least squares."""

import numpy as np
import pytest

from semlive.kernels.local_planes import SOFT, fit_local_planes

RNG = np.random.default_rng(3)
U, V = RNG.standard_normal((2, 9, 12))
TRUSTED = RNG.random((9, 12)) < 0.7
TRUSTED[:3, :3] = False


def test_planes_are_those_of_least_squares():
    at = np.zeros(U.shape, dtype=bool)
    at[[0, 4, 8], [0, 6, 11]] = True
    u, v, slopes, count = fit_local_planes(U, V, TRUSTED, at, 2)
    for k, (j, i) in enumerate(zip(*np.nonzero(at), strict=True)):
        window = np.s_[max(j - 2, 0) : j + 3, max(i - 2, 0) : i + 3]
        rows, columns = np.nonzero(TRUSTED[window])
        assert count[k] == rows.size
        if not rows.size:
            assert u[k] == v[k] == 0.0
            continue
        place = np.column_stack([columns - i, rows - j]) + np.maximum([i - 2, j - 2], 0)
        middle = place.mean(axis=0)
        matrix = (place - middle).T @ (place - middle) / rows.size + SOFT * np.eye(2)
        for value, found, slope in ((U, u, slopes[:, :2]), (V, v, slopes[:, 2:])):
            values = value[window][rows, columns]
            expected = np.linalg.solve(matrix, (place - middle).T @ (values - values.mean()) / rows.size)
            assert np.allclose(slope[k], expected)
            assert np.isclose(found[k], values.mean() - expected @ middle)


def test_planes_check_their_arrays():
    with pytest.raises(ValueError, match=r"^v must have shape"):
        fit_local_planes(U, V[:4], TRUSTED, TRUSTED, 1)
    with pytest.raises(ValueError, match=r"^at must be bool"):
        fit_local_planes(U, V, TRUSTED, TRUSTED.astype(np.uint8), 1)
