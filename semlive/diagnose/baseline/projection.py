"""Laws made ready to be asked about: whitened, and multiplied with the baseline's columns once.

A search asks all laws again after every effect that it adds; the baseline's own columns, which take most of the time, are the same then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import DesignMatrix, HyperparameterGrid
from semlive.model.effects import EffectClass, RunGeometry

Array = NDArray[np.float64]
COLUMNS_AT_ONCE = 256


@dataclass(frozen=True, slots=True, eq=False)
class WhitenedColumns:
    """Columns of one or several laws; most move things along one axis only, and are held for that axis alone.

    Attributes:
        spans: which of the columns are each law's.
        index: for x and for y, the columns that move things along it.
        rows: for x and for y, (their number, f b), each column in one piece.
        gram_matrices: of each law (q, q) products of its columns with each other.
        residual_products: (q,) products with what the first solution leaves of the data.
        baseline_products: for x and for y, (m, their number) products with the columns that the baseline had.
    """

    spans: tuple[slice, ...]
    index: tuple[NDArray[np.int64], NDArray[np.int64]]
    rows: tuple[Array, Array]
    gram_matrices: tuple[Array, ...]
    residual_products: Array
    baseline_products: tuple[Array, Array]

    @classmethod
    def of(cls, ladder: HyperparameterGrid, fields: Sequence[Array]) -> WhitenedColumns:
        """Laws' columns (f, b, 2, q) in px."""
        design, residual = ladder.design, ladder.whitened_residual
        ends = np.cumsum([0, *(field.shape[-1] for field in fields)]).tolist()
        index, rows, shared, gradient = [], [], [], np.zeros(ends[-1])
        eigenvalues, white = np.zeros(0), np.zeros(0)
        for axis, each in enumerate(_in_one_piece(fields)):
            there = np.flatnonzero(each.any(axis=(1, 2)))
            before, eigenvalues = eigenvalues, each[there]
            # Most laws of many columns have the same along x and along y.
            white = white if np.array_equal(before, eigenvalues) else design.whiten.rows(eigenvalues)
            flat = white.reshape(len(there), residual[:, :, axis].size)
            gradient[there] += flat @ residual[:, :, axis].ravel()
            index.append(there)
            rows.append(flat)
            shared.append(design.along(axis, white))
        spans = tuple(slice(first, last) for first, last in pairwise(ends))
        alone = tuple(_among(index, rows, own) for own in spans)
        return cls(spans, (index[0], index[1]), (rows[0], rows[1]), alone, gradient, (shared[0], shared[1]))

    def products_with(self, design: DesignMatrix) -> Array:
        """(p, q) products with all columns of a baseline: that which these were made for, and effects that it got since."""
        total = np.zeros((design.size, len(self.residual_products)))
        for axis in (0, 1):
            had, there = len(self.baseline_products[axis]), self.index[axis]
            total[np.ix_(design.index[axis][:had], there)] += self.baseline_products[axis]
            if had < design.columns[axis].shape[1]:
                total[np.ix_(design.index[axis][had:], there)] += design.columns[axis][:, had:].T @ self.rows[axis].T
        return total

    def along(self, noise: tuple[Array, Array]) -> Array:
        """(q, draws) columns times whitened noise, (f b, draws) for x and for y."""
        total = np.zeros((len(self.residual_products), noise[0].shape[1]))
        for there, rows, value in zip(self.index, self.rows, noise, strict=True):
            total[there] += rows @ value
        return total


@dataclass(frozen=True, slots=True, eq=False)
class CandidateProjection:
    """A family's laws.

    Attributes:
        values: what is not linear, for each law.
        batches: the laws in their order.
    """

    values: tuple[dict[str, float], ...]
    batches: tuple[WhitenedColumns, ...]

    @property
    def nbytes(self) -> int:
        """Of the columns."""
        return sum(rows.nbytes for batch in self.batches for rows in batch.rows)


def project_candidate(ladder: HyperparameterGrid, family: EffectClass, scene: RunGeometry) -> CandidateProjection | None:
    """A family's laws on a scene; None where none of them can be seen."""
    basis_fields = [(dict(values), family.law(scene, values)) for values in family.grid(scene)]
    observed = [(values, basis_field.field_px) for values, basis_field in basis_fields if basis_field is not None]
    if not observed:
        return None
    each = max(1, COLUMNS_AT_ONCE // observed[0][1].shape[-1])
    batches = [
        WhitenedColumns.of(ladder, [field for _, field in observed[first : first + each]]) for first in range(0, len(observed), each)
    ]
    return CandidateProjection(tuple(values for values, _ in observed), tuple(batches))


def _in_one_piece(fields: Sequence[Array]) -> Array:
    """(2, q, f, b) columns of fields (f, b, 2, q), each in one piece.

    Laws have their columns side by side; 64 of 4 columns put beside each other like that took three times as long as whitening them.
    """
    if len(fields) == 1:
        return fields[0].transpose(2, 3, 0, 1)
    stacked = np.empty((2, sum(field.shape[-1] for field in fields), *fields[0].shape[:2]))
    first = 0
    for field in fields:
        stacked[:, first : first + field.shape[-1]] = field.transpose(2, 3, 0, 1)
        first += field.shape[-1]
    return stacked


def _among(index: Sequence[NDArray[np.int64]], rows: Sequence[Array], own: slice) -> Array:
    total = np.zeros((own.stop - own.start,) * 2)
    for there, map_rows in zip(index, rows, strict=True):
        low, high = np.searchsorted(there, (own.start, own.stop))
        at = there[low:high] - own.start
        total[np.ix_(at, at)] += map_rows[low:high] @ map_rows[low:high].T
    return total
