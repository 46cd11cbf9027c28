"""Sums over local columns, against the same with dense matrices."""

import numpy as np
import pytest

from semlive.kernels.splines.bilinear import interpolate_bilinear
from semlive.kernels.splines.spline_columns import evaluate_curve, evaluate_piecewise, evaluate_surface, local_sums, piecewise, tensor_sums

RNG = np.random.default_rng(8)
POINTS, BLOCKS, NY, NX = 60, 5, 7, 9
BLOCK = RNG.integers(0, BLOCKS, POINTS)
INDEX_Y, INDEX_X = (RNG.integers(0, n - 3, (POINTS, 1)) + np.arange(4) for n in (NY, NX))
VALUE_Y, VALUE_X = RNG.normal(size=(2, POINTS, 4))


def dense(index, value, size):
    rows = np.zeros((len(index), size))
    np.put_along_axis(rows, index, value, axis=1)
    return rows


ROWS_Y, ROWS_X = dense(INDEX_Y, VALUE_Y, NY), dense(INDEX_X, VALUE_X, NX)


def test_a_surface_is_the_product_of_rows_along_y_and_x():
    surface = RNG.normal(size=(NY, NX, 2))
    expected = np.einsum("pj,pi,jic->pc", ROWS_Y, ROWS_X, surface)
    np.testing.assert_allclose(evaluate_surface(INDEX_Y, VALUE_Y, INDEX_X, VALUE_X, surface), expected, atol=1e-12)


def test_a_given_number_of_terms_gives_the_same_columns():
    six_y, six_x = RNG.integers(0, 4, (POINTS, 1)) + np.arange(6), RNG.integers(0, 3, (POINTS, 1)) + np.arange(6)
    value_y, value_x, surface = RNG.normal(size=(POINTS, 6)), RNG.normal(size=(POINTS, 6)), RNG.normal(size=(NY + 3, NX, 2))
    rows_y, rows_x = dense(six_y, value_y, NY + 3), dense(six_x, value_x, NX)
    found = evaluate_surface(six_y, value_y, six_x, value_x, surface)
    np.testing.assert_allclose(found, np.einsum("pj,pi,jic->pc", rows_y, rows_x, surface), atol=1e-12)
    sums = tensor_sums(BLOCK, BLOCKS, six_y, value_y, six_x, value_x, (NY + 3, NX))
    np.testing.assert_allclose(sums, np.einsum("pb,pj,pi->bji", np.eye(BLOCKS)[BLOCK], rows_y, rows_x), atol=1e-12)
    for count in (4, 5, 6):
        table, at = RNG.normal(size=(count, count)), RNG.uniform(-1.0, 4.0, POINTS)
        index, value = evaluate_piecewise(at, 0.0, 1.0, 3, table)
        fraction = at - np.clip(np.floor(at), 0, 2)
        np.testing.assert_array_equal(index[:, -1], np.clip(np.floor(at), 0, 2) + count - 1)
        np.testing.assert_allclose(value, sum(table[k] * fraction[:, None] ** k for k in range(count)), atol=1e-9)


def test_a_curve_is_the_product_of_rows():
    curve = RNG.normal(size=(NX, 2))
    np.testing.assert_allclose(evaluate_curve(INDEX_X, VALUE_X, curve), ROWS_X @ curve, atol=1e-12)


def test_fields_between_points_are_bilinear_and_report_the_spread_of_their_corners():
    fields, status = RNG.normal(size=(3, NY, NX)), RNG.integers(0, 3, (NY, NX)).astype(np.uint8)
    x, y = RNG.uniform(-1.0, NX, POINTS), RNG.uniform(-1.0, NY, POINTS)
    value, spread, worst, sound = interpolate_bilinear(x, y, fields, status)
    i, j = np.clip(np.floor(x).astype(int), 0, NX - 2), np.clip(np.floor(y).astype(int), 0, NY - 2)
    tx, ty = np.clip(x - i, 0.0, 1.0), np.clip(y - j, 0.0, 1.0)
    corners = fields[:, [j, j, j + 1, j + 1], [i, i + 1, i, i + 1]]
    np.testing.assert_allclose(value, np.sum([(1 - ty) * (1 - tx), (1 - ty) * tx, ty * (1 - tx), ty * tx] * corners, axis=1), atol=1e-12)
    np.testing.assert_array_equal(spread, np.ptp(corners[:2], axis=1))
    np.testing.assert_array_equal(worst, status[[j, j, j + 1, j + 1], [i, i + 1, i, i + 1]].max(axis=0))
    np.testing.assert_array_equal(sound, worst == 0)


def test_sums_over_blocks_are_those_of_dense_rows():
    member = np.eye(BLOCKS)[BLOCK]
    found = tensor_sums(BLOCK, BLOCKS, INDEX_Y, VALUE_Y, INDEX_X, VALUE_X, (NY, NX))
    np.testing.assert_allclose(found, np.einsum("pb,pj,pi->bji", member, ROWS_Y, ROWS_X), atol=1e-12)
    np.testing.assert_allclose(local_sums(BLOCK, BLOCKS, INDEX_X, VALUE_X, 0, NX), member.T @ ROWS_X, atol=1e-12)


def test_polynomials_by_pieces():
    table, piece, fraction = RNG.normal(size=(3, 4, 5)), RNG.integers(0, 3, POINTS), RNG.random(POINTS)
    expected = sum(table[piece, k] * fraction[:, None] ** k for k in range(4))
    np.testing.assert_allclose(piecewise(table, piece, fraction), expected, atol=1e-12)


def test_an_index_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="index_x must lie between 0 and 7"):
        evaluate_surface(INDEX_Y, VALUE_Y, INDEX_X, VALUE_X, np.zeros((NY, 8, 2)))
    with pytest.raises(ValueError, match="index_y must count up by one along each row"):
        evaluate_surface(INDEX_Y[:, ::2].copy(), VALUE_Y[:, ::2].copy(), INDEX_X, VALUE_X, np.zeros((NY, NX, 2)))
    with pytest.raises(ValueError, match="index must lie between 0 and 7"):
        evaluate_curve(INDEX_X, VALUE_X, np.zeros((8, 2)))
    with pytest.raises(ValueError, match="block must lie between 0 and 3"):
        tensor_sums(BLOCK, 4, INDEX_Y, VALUE_Y, INDEX_X, VALUE_X, (NY, NX))
    with pytest.raises(ValueError, match="less the first coefficient"):
        local_sums(BLOCK, BLOCKS, INDEX_X, VALUE_X, 1, NX)
    with pytest.raises(ValueError, match="piece must lie between 0 and 1"):
        piecewise(np.zeros((2, 4, 5)), np.array([2]), np.zeros(1))


def test_positions_outside_belong_to_the_outermost_interval():
    table = RNG.normal(size=(4, 5))
    index, value = evaluate_piecewise(np.array([-1.0, 2.5, 9.0]), 1.0, 2.0, 3, table)
    assert index[:, 0].tolist() == [0, 0, 2]
    np.testing.assert_array_equal(index, index[:, :1] + np.arange(5))
    fraction = np.array([-1.0, 0.75, 2.0])
    np.testing.assert_allclose(value, sum(table[k] * fraction[:, None] ** k for k in range(4)), atol=1e-12)
