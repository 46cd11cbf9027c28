"""Local columns of a design matrix: polynomials by pieces, what a surface is at points, what points of a block have in common."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from semlive.kernels.arrays import checked

Field = NDArray[np.float64]
Index = NDArray[np.int64]


def evaluate_surface(index_y: Index, value_y: Field, index_x: Index, value_x: Field, surface: Field) -> Field:
    """(n, 2) both components of a tensor-product surface at points.

    Args:
        index_y: (n, ky) coefficients along y that each point touches, ky in a row.
        value_y: (n, ky) their factors.
        index_x: (n, kx) along x, likewise.
        value_x: (n, kx) their factors.
        surface: (ny, nx, 2) coefficients.

    Raises:
        ValueError: an array is of another type or shape, or an index is not of the surface.
    """
    rows = _checked_rows(index_y, value_y, index_x, value_x, np.shape(surface)[:2])
    total = np.empty((len(index_y), 2))
    _surface(*rows, checked(surface, "surface", np.float64, (None, None, 2)), total)
    return total


def evaluate_curve(index: Index, value: Field, curve: Field) -> Field:
    """(n, 2) both components of a curve at points.

    Args:
        index: (n, k) coefficients that each point touches.
        value: (n, k) their factors.
        curve: (m, 2) coefficients.

    Raises:
        ValueError: an array is of another type or shape, or an index is not of the curve.
    """
    checked(index, "index", np.int64, (None, None))
    checked(value, "value", np.float64, index.shape)
    checked(curve, "curve", np.float64, (None, 2))
    _within(index, "index", len(curve))
    total = np.empty((len(index), 2))
    _curve(index, value, curve, total)
    return total


def tensor_sums(block: Index, blocks: int, index_y: Index, value_y: Field, index_x: Index, value_x: Field, shape: tuple[int, int]) -> Field:
    """(blocks, ny, nx) sums over the points of each block of the products of their factors along y and x.

    Args:
        block: (n,) block of each point.
        blocks: how many there are.
        index_y: (n, ky) coefficients along y that each point touches, ky in a row.
        value_y: (n, ky) their factors.
        index_x: (n, kx) along x, likewise.
        value_x: (n, kx) their factors.
        shape: (ny, nx) of the coefficients.

    Raises:
        ValueError: an array is of another type or shape, or an index does not fit.
    """
    rows = _checked_rows(index_y, value_y, index_x, value_x, shape)
    checked(block, "block", np.int64, (len(index_y),))
    _within(block, "block", blocks)
    total = np.zeros((blocks, *shape))
    _sums(block, *rows, total)
    return total


def local_sums(block: Index, blocks: int, index: Index, value: Field, low: int, span: int) -> Field:
    """(blocks, span) sums over the points of each block of their factors at coefficients low ... low + span - 1.

    Args:
        block: (n,) block of each point.
        blocks: how many there are.
        index: (n, k) coefficients that each point touches.
        value: (n, k) their factors.
        low: the first coefficient.
        span: number of coefficients.

    Raises:
        ValueError: an array is of another type or shape, or an index does not fit.
    """
    checked(index, "index", np.int64, (len(block), None))
    checked(value, "value", np.float64, index.shape)
    checked(block, "block", np.int64, (None,))
    _within(block, "block", blocks)
    if index.size and (int(index.min()) < low or int(index.max()) >= low + span):
        raise ValueError(f"index less the first coefficient must lie between 0 and {span - 1}")
    total = np.zeros((blocks, span))
    _local(block, index, value, low, total)
    return total


def evaluate_piecewise(position: Field, origin: float, spacing: float, intervals: int, table: Field) -> tuple[Index, Field]:
    """(n, m) indices and (n, m) values of functions that are one polynomial each on every interval of the same length.

    Args:
        position: (n,) where.
        origin: where the first interval begins.
        spacing: length of an interval.
        intervals: how many there are; positions outside belong to the outermost.
        table: (degree + 1, m) ``[k, j]`` is the coefficient of f^k of function j, with the fraction f of the interval.

    Raises:
        ValueError: an array is of another type or shape.
    """
    checked(position, "position", np.float64, (None,))
    checked(table, "table", np.float64, (None, None))
    index, value = np.empty((len(position), table.shape[1]), dtype=np.int64), np.empty((len(position), table.shape[1]))
    _on_intervals(position, origin, spacing, intervals, table, index, value)
    return index, value


def piecewise(table: Field, piece: Index, fraction: Field) -> Field:
    """(n, m) polynomials in the fraction of a piece: ``sum_k table[piece, k, j] fraction^k``.

    Args:
        table: (pieces, degree + 1, m) coefficients.
        piece: (n,) the piece of each point.
        fraction: (n,) where in it.

    Raises:
        ValueError: an array is of another type or shape, or there is no such piece.
    """
    checked(table, "table", np.float64, (None, None, None))
    checked(piece, "piece", np.int64, (None,))
    checked(fraction, "fraction", np.float64, piece.shape)
    _within(piece, "piece", len(table))
    value = np.empty((len(piece), table.shape[2]))
    _polynomials(table, piece, fraction, value)
    return value


def _checked_rows(
    index_y: Index, value_y: Field, index_x: Index, value_x: Field, shape: tuple[int, ...]
) -> tuple[Index, Field, Index, Field]:
    n = len(index_y)
    checked(index_y, "index_y", np.int64, (n, None))
    checked(index_x, "index_x", np.int64, (n, None))
    checked(value_y, "value_y", np.float64, index_y.shape)
    checked(value_x, "value_x", np.float64, index_x.shape)
    _in_a_row(index_y, "index_y", shape[0])
    _in_a_row(index_x, "index_x", shape[1])
    return index_y, value_y, index_x, value_x


def _in_a_row(index: Index, name: str, count: int) -> None:
    """The first of each row and as many as it has lie within; that they count up by one is on whoever made them."""
    first, last = index[:, 0], index[:, -1]
    if not (last - first == index.shape[1] - 1).all():
        raise ValueError(f"{name} must count up by one along each row")
    if len(index) and (int(first.min()) < 0 or int(last.max()) >= count):
        raise ValueError(f"{name} must lie between 0 and {count - 1}")


def _within(index: Index, name: str, count: int) -> None:
    if index.size and (int(index.min()) < 0 or int(index.max()) >= count):
        raise ValueError(f"{name} must lie between 0 and {count - 1}")


# Numbers of terms that are known beforehand take from half to two thirds of the time: cubics and quintics, which all splines here are.


@njit(nogil=True, cache=True)
def _surface(index_y, value_y, index_x, value_x, surface, total):
    along_y, along_x = index_y.shape[1], index_x.shape[1]
    if along_y == 6 and along_x == 6:
        _surface_of(index_y, value_y, index_x, value_x, surface, total, 6, 6)
    else:
        _surface_of(index_y, value_y, index_x, value_x, surface, total, along_y, along_x)


@njit(nogil=True, inline="always")
def _surface_of(index_y, value_y, index_x, value_x, surface, total, count_y, count_x):
    for point in range(index_y.shape[0]):
        x, y, first_y, first_x = 0.0, 0.0, index_y[point, 0], index_x[point, 0]
        for j in range(count_y):
            row = surface[first_y + j]
            along_x, along_y = 0.0, 0.0
            for i in range(count_x):
                factor = value_x[point, i]
                along_x += factor * row[first_x + i, 0]
                along_y += factor * row[first_x + i, 1]
            x += value_y[point, j] * along_x
            y += value_y[point, j] * along_y
        total[point, 0] = x
        total[point, 1] = y


@njit(nogil=True, cache=True)
def _curve(index, value, curve, total):
    for point in range(index.shape[0]):
        x, y = 0.0, 0.0
        for k in range(index.shape[1]):
            at, factor = index[point, k], value[point, k]
            x += factor * curve[at, 0]
            y += factor * curve[at, 1]
        total[point, 0] = x
        total[point, 1] = y


@njit(nogil=True, cache=True)
def _sums(block, index_y, value_y, index_x, value_x, total):
    along_y, along_x = index_y.shape[1], index_x.shape[1]
    if along_y == 6 and along_x == 6:
        _sums_of(block, index_y, value_y, index_x, value_x, total, 6, 6)
    else:
        _sums_of(block, index_y, value_y, index_x, value_x, total, along_y, along_x)


@njit(nogil=True, inline="always")
def _sums_of(block, index_y, value_y, index_x, value_x, total, count_y, count_x):
    for point in range(index_y.shape[0]):
        own, first_y, first_x = total[block[point]], index_y[point, 0], index_x[point, 0]
        for j in range(count_y):
            row, factor = own[first_y + j], value_y[point, j]
            for i in range(count_x):
                row[first_x + i] += factor * value_x[point, i]


@njit(nogil=True, cache=True)
def _local(block, index, value, low, total):
    for point in range(index.shape[0]):
        own = total[block[point]]
        for j in range(index.shape[1]):
            own[index[point, j] - low] += value[point, j]


@njit(nogil=True, cache=True)
def _polynomials(table, piece, fraction, value):
    for point in range(piece.shape[0]):
        of, f = table[piece[point]], fraction[point]
        for j in range(of.shape[1]):
            total = of[of.shape[0] - 1, j]
            for power in range(of.shape[0] - 2, -1, -1):
                total = total * f + of[power, j]
            value[point, j] = total


@njit(nogil=True, cache=True)
def _on_intervals(position, origin, spacing, intervals, table, index, value):
    terms, count = table.shape
    if terms == 4 and count == 4:
        _on_each(position, origin, spacing, intervals, table, index, value, 4, 4)
    elif terms == 6 and count == 6:
        _on_each(position, origin, spacing, intervals, table, index, value, 6, 6)
    else:
        _on_each(position, origin, spacing, intervals, table, index, value, terms, count)


@njit(nogil=True, inline="always")
def _on_each(position, origin, spacing, intervals, table, index, value, terms, count):
    for point in range(position.size):
        scaled = (position[point] - origin) / spacing
        first = min(max(np.floor(scaled), 0.0), intervals - 1.0)
        f, own, at, low = scaled - first, value[point], index[point], np.int64(first)
        for j in range(count):
            total = table[terms - 1, j]
            for power in range(terms - 2, -1, -1):
                total = total * f + table[power, j]
            own[j] = total
            at[j] = low + j
