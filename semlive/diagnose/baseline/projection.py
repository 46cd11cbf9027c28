"""Basis fields prepared for repeated scoring: whitened, and multiplied once with the columns of the baseline.

A search scores all basis fields again after each added effect. The columns of the baseline, which take most of the time, do not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.design_matrix import DesignMatrix
from semlive.model.effects import EffectClass, RunGeometry

Array = NDArray[np.float64]
COLUMNS_AT_ONCE = 256


@dataclass(frozen=True, slots=True, eq=False)
class WhitenedColumns:
    """Whitened columns of one or several basis fields. Columns along one axis only are stored for that axis only.

    Attributes:
        spans: range of the columns of each basis field.
        index: for x and for y, the columns that are not zero along it.
        rows: for x and for y, (their number, f b), each column contiguous.
        gram_matrices: for each basis field, (q, q) products of its columns.
        residual_products: (q,) products with the residual of the first solution.
        baseline_products: for x and for y, (m, their number) products with the columns of the baseline.
    """

    spans: tuple[slice, ...]
    index: tuple[NDArray[np.int64], NDArray[np.int64]]
    rows: tuple[Array, Array]
    gram_matrices: tuple[Array, ...]
    residual_products: Array
    baseline_products: tuple[Array, Array]

    @classmethod
    def of(cls, baseline: HyperparameterGrid, fields: Sequence[Array]) -> WhitenedColumns:
        """Whiten the columns (f, b, 2, q) of basis fields, px."""
        design, residual = baseline.design, baseline.whitened_residual
        ends = np.cumsum([0, *(field.shape[-1] for field in fields)]).tolist()
        index, rows, baseline_products, gradient = [], [], [], np.zeros(ends[-1])
        current, white = np.zeros(0), np.zeros(0)
        for axis, each in enumerate(_stack_columns(fields)):
            nonzero = np.flatnonzero(each.any(axis=(1, 2)))
            previous, current = current, each[nonzero]
            # Most basis fields with many columns have equal columns along x and along y.
            reusable = design.whiten.over_frames is None and np.array_equal(previous, current)
            white = white if reusable else design.whiten.rows(axis, current)
            flat = white.reshape(len(nonzero), residual[:, :, axis].size)
            gradient[nonzero] += flat @ residual[:, :, axis].ravel()
            index.append(nonzero)
            rows.append(flat)
            baseline_products.append(design.along(axis, white))
        spans = tuple(slice(first, last) for first, last in pairwise(ends))
        gram_matrices = tuple(_gram(index, rows, own) for own in spans)
        return cls(spans, (index[0], index[1]), (rows[0], rows[1]), gram_matrices, gradient, (baseline_products[0], baseline_products[1]))

    def products_with(self, design: DesignMatrix) -> Array:
        """(p, q) products with all columns of a design matrix: the original baseline and effects added since."""
        total = np.zeros((design.size, len(self.residual_products)))
        for axis in (0, 1):
            baseline_count, nonzero = len(self.baseline_products[axis]), self.index[axis]
            total[np.ix_(design.index[axis][:baseline_count], nonzero)] += self.baseline_products[axis]
            if baseline_count < design.columns[axis].shape[1]:
                total[np.ix_(design.index[axis][baseline_count:], nonzero)] += (
                    design.columns[axis][:, baseline_count:].T @ self.rows[axis].T
                )
        return total

    def along(self, noise: tuple[Array, Array]) -> Array:
        """(q, draws) columns times whitened noise, (f b, draws) for x and for y."""
        total = np.zeros((len(self.residual_products), noise[0].shape[1]))
        for nonzero, rows, value in zip(self.index, self.rows, noise, strict=True):
            total[nonzero] += rows @ value
        return total


@dataclass(frozen=True, slots=True, eq=False)
class CandidateProjection:
    """Basis fields of one effect class.

    Attributes:
        values: nonlinear parameters of each basis field.
        batches: whitened basis fields in the same order.
    """

    values: tuple[dict[str, float], ...]
    batches: tuple[WhitenedColumns, ...]

    @property
    def nbytes(self) -> int:
        """Memory of the columns, bytes."""
        return sum(rows.nbytes for batch in self.batches for rows in batch.rows)


def project_candidate(baseline: HyperparameterGrid, family: EffectClass, scene: RunGeometry) -> CandidateProjection | None:
    """Basis fields of an effect class for a run geometry; None if none is observable."""
    basis_fields = [(dict(values), family.basis_field(scene, values)) for values in family.grid(scene)]
    observed = [(values, basis_field.field_px) for values, basis_field in basis_fields if basis_field is not None]
    if not observed:
        return None
    each = max(1, COLUMNS_AT_ONCE // observed[0][1].shape[-1])
    batches = [
        WhitenedColumns.of(baseline, [field for _, field in observed[first : first + each]]) for first in range(0, len(observed), each)
    ]
    return CandidateProjection(tuple(values for values, _ in observed), tuple(batches))


def _stack_columns(fields: Sequence[Array]) -> Array:
    """(2, q, f, b) contiguous columns of fields (f, b, 2, q).

    Concatenating 64 fields of 4 interleaved columns directly took three times as long as whitening them.
    """
    if len(fields) == 1:
        return fields[0].transpose(2, 3, 0, 1)
    stacked = np.empty((2, sum(field.shape[-1] for field in fields), *fields[0].shape[:2]))
    first = 0
    for field in fields:
        stacked[:, first : first + field.shape[-1]] = field.transpose(2, 3, 0, 1)
        first += field.shape[-1]
    return stacked


def _gram(index: Sequence[NDArray[np.int64]], rows: Sequence[Array], own: slice) -> Array:
    total = np.zeros((own.stop - own.start,) * 2)
    for nonzero, map_rows in zip(index, rows, strict=True):
        low, high = np.searchsorted(nonzero, (own.start, own.stop))
        at = nonzero[low:high] - own.start
        total[np.ix_(at, at)] += map_rows[low:high] @ map_rows[low:high].T
    return total
