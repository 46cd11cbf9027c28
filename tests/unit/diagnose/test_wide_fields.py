"""Log Bayes factors of fields with many columns: from Cholesky factors of both axes as from the eigenvectors of all columns."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from semlive.diagnose.baseline.bayes_factor import log_factor
from semlive.diagnose.baseline.wide_fields import MIN_COLUMNS, WideField
from semlive.estimate.joint.elimination.arrowhead import ComponentBlocks, factorise

SIZES_PX = np.geomspace(3e-4, 1.0, 6)
BLOCKS = ComponentBlocks(np.arange(0, 12), np.arange(12, 20), np.arange(20, 23))


def batch(first: int, x: np.ndarray, y: np.ndarray, gram: np.ndarray) -> Any:
    """As much of a batch of whitened columns as describes its second field, whose columns begin at `first`."""
    spans = slice(0, first), slice(first, first + len(gram))
    return SimpleNamespace(spans=spans, index=(x + first, y + first), gram_matrices=(np.eye(first), gram))


def information(rng: np.random.Generator, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(q, q) products of columns, and (p, q) forward substitution of their products with the baseline."""
    rows, design = (np.zeros((2, 300, count)) for count in (len(x) + len(y), 23))
    for axis, (at, own) in enumerate(((x, BLOCKS.x), (y, BLOCKS.y))):
        rows[axis][:, at] = rng.normal(size=(300, len(at)))
        design[axis][:, own] = rng.normal(size=(300, len(own)))
        design[axis][:, BLOCKS.shared] = rng.normal(size=(300, 3)) + rows[axis][:, at[:1]]  # nearly explained by one column
    flat, columns = rows.reshape(600, -1), design.reshape(600, -1)
    half = factorise(columns.T @ columns + 1e-6 * np.eye(23), BLOCKS, 0.0).half(columns.T @ flat)
    return flat.T @ flat, half


def test_both_axes_and_their_common_parameters_give_the_factor_of_all_columns() -> None:
    rng = np.random.default_rng(5)
    order = rng.permutation(100)
    x, y = np.sort(order[:60]), np.sort(order[60:])
    gram, half = information(rng, x, y)
    gradients = 30.0 * rng.normal(size=(4, 100))
    field = WideField.of(batch(7, x, y, gram), 1)
    assert field is not None
    assert field.columns == 100

    values, vectors = np.linalg.eigh(gram - half.T @ half)
    together = log_factor(values, (gradients @ vectors)[:, None], SIZES_PX[:, None])
    assert field.log_factors(half, BLOCKS, gradients, SIZES_PX) == pytest.approx(together, rel=1e-10, abs=1e-9)


def test_few_columns_and_columns_along_both_axes_have_no_such_factors() -> None:
    few, both = np.arange(MIN_COLUMNS // 2 - 1), np.arange(MIN_COLUMNS)
    assert WideField.of(batch(0, few, few + len(few), np.eye(2 * len(few))), 1) is None
    assert WideField.of(batch(0, both, both, np.eye(len(both))), 1) is None


def test_information_that_is_negative_by_rounding_is_refused() -> None:
    gram, x, y = np.eye(MIN_COLUMNS), np.arange(MIN_COLUMNS // 2), np.arange(MIN_COLUMNS // 2, MIN_COLUMNS)
    field = WideField.of(batch(0, x, y, -1e9 * gram), 1)
    assert field is not None
    with pytest.raises(np.linalg.LinAlgError):
        field.log_factors(np.zeros((23, MIN_COLUMNS)), BLOCKS, np.zeros((1, MIN_COLUMNS)), SIZES_PX)
