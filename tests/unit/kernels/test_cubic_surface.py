"""A bicubic surface with knots of its own, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from semlive.kernels.splines.cubic_surface import evaluate_cubic_surface

RNG = np.random.default_rng(11)


@pytest.mark.parametrize(("rows", "columns"), [(4, 5), (40, 46), (9, 4)])
def test_both_components_are_those_of_scipy(rows: int, columns: int) -> None:
    at_y, at_x = np.cumsum(RNG.uniform(0.5, 30.0, rows)), np.cumsum(RNG.uniform(0.5, 30.0, columns))
    splines = [RectBivariateSpline(at_y, at_x, RNG.normal(0.0, 3.0, (rows, columns))) for _ in range(2)]
    knots_y, knots_x = splines[0].get_knots()
    surface = np.stack([one.get_coeffs().reshape(rows, columns) for one in splines])
    # Within, on the knots, and beyond the edge.
    y = np.concatenate([RNG.uniform(-50.0, at_y[-1] + 50.0, 5000), RNG.choice(knots_y, 200)])
    x = np.concatenate([RNG.uniform(-50.0, at_x[-1] + 50.0, 5000), RNG.choice(knots_x, 200)])
    expected = np.stack([one.ev(y, x) for one in splines], axis=-1)
    # To the last bit, unless a compiler contracts products and sums on another processor.
    np.testing.assert_allclose(evaluate_cubic_surface(knots_y, knots_x, surface, y, x), expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("knots", "shape", "points", "words"), [(7, (2, 3, 3), 5, "8 knots"), (9, (2, 5, 4), 5, "surface"), (9, (2, 5, 5), 4, "x must")]
)
def test_what_does_not_fit_is_refused(knots: int, shape: tuple[int, ...], points: int, words: str) -> None:
    along = np.arange(float(knots))
    with pytest.raises(ValueError, match=words):
        evaluate_cubic_surface(along, along, np.zeros(shape), np.zeros(5), np.zeros(points))
