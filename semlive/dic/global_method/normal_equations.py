"""Normal equations of the field, with the unknowns of each row eliminated.

Each row of the reference has an offset, a gain and a shift along x and y of its own. They couple only the control points whose splines
reach the row, so after their elimination the matrix keeps its band (Schur complement).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.dic.global_method.spline_field import Lattice

Array = NDArray[np.float64]
Image = NDArray[np.float32]

ROW_UNKNOWNS = 4  # offset, gain, shift along x, shift along y


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations of the control points, without regularisation, and what the rows need for back substitution.

    Attributes:
        diagonal: (n, m, m) blocks; the m = 6 nx unknowns of a block are u and v of three rows of control points.
        upper: (n - 1, m, m) blocks right of them.
        right: (n, m) right side.
        row_matrix: (height, 4, 4) information matrix of the unknowns of each row, prior included.
        row_right: (height, 4) its right side.
        row_coupling: (height, 4, 2, nx) coupling of each row with the splines along x.
    """

    diagonal: Array
    upper: Array
    right: Array
    row_matrix: Array
    row_right: Array
    row_coupling: Array


def assemble(
    lattice: Lattice,
    reference: Image,
    residual: Image,
    gradient: tuple[Image, Image],
    weight: Image,
    row_prior: Array,
    row_offset: Array,
) -> Equations:
    """Linearise the squared residuals at the present field.

    Args:
        lattice: control points.
        reference: (height, width) filtered reference.
        residual: (height, width) warped current frame minus reference.
        gradient: (height, width) each, derivative of the warped frame along x and y.
        weight: (height, width) weight of each pixel, 1/variance; 0 where the frames do not overlap.
        row_prior: (4,) precision of the prior of the unknowns of a row.
        row_offset: (height, 4) present values of these unknowns, from which the prior pulls back.
    """
    (ny, nx), height = lattice.counts, lattice.shape[0]
    bx, by = lattice.columns, lattice.rows
    w = weight.astype(np.float64)
    r, gx, gy, f = (a.astype(np.float64) for a in (residual, *gradient, reference))
    weighted = (w * gx, w * gy)
    pairs = np.stack([bx[:, :] * np.pad(bx, ((0, 0), (0, e)))[:, e:] for e in range(4)])  # (4, width, nx)
    products = {
        (0, 0): np.einsum("yx,exi->eyi", weighted[0] * gx, pairs, optimize=True),
        (0, 1): np.einsum("yx,exi->eyi", weighted[0] * gy, pairs, optimize=True),
        (1, 1): np.einsum("yx,exi->eyi", weighted[1] * gy, pairs, optimize=True),
    }
    columns = (-np.ones_like(f), -f, gx, gy)
    coupling = np.stack([np.stack([(column * g) @ bx for g in weighted], axis=1) for column in columns], axis=1)
    matrix = np.empty((height, ROW_UNKNOWNS, ROW_UNKNOWNS))
    for a in range(ROW_UNKNOWNS):
        for b in range(a, ROW_UNKNOWNS):
            matrix[:, a, b] = matrix[:, b, a] = np.einsum("yx,yx,yx->y", w, columns[a], columns[b])
    matrix[:, range(ROW_UNKNOWNS), range(ROW_UNKNOWNS)] += row_prior
    row_right = -np.stack([np.einsum("yx,yx,yx->y", w, column, r) for column in columns], axis=1) - row_prior * row_offset
    lower = np.linalg.cholesky(np.linalg.inv(matrix))
    reduced = np.einsum("yba,ybci->yaci", lower, coupling).reshape(height, ROW_UNKNOWNS, 2 * nx)
    reduced_right = np.einsum("yba,yb->ya", lower, row_right)

    field_right = np.stack([-(by.T @ (g * r) @ bx) for g in weighted])  # (2, ny, nx)
    field_right -= np.einsum("yj,yak,ya->jk", by, reduced, reduced_right, optimize=True).reshape(ny, 2, nx).transpose(1, 0, 2)

    n, m = ny // 3, 6 * nx
    blocks = _field_blocks(lattice, products, reduced)
    right = field_right.reshape(2, n, 3, nx).transpose(1, 0, 2, 3).reshape(n, m)
    return Equations(blocks[:, 0], blocks[:-1, 1], right, matrix, row_right, coupling)


def _field_blocks(lattice: Lattice, products: dict[tuple[int, int], Array], reduced: Array) -> Array:
    """(n, 2, m, m) diagonal and next blocks of the matrix of the field, after elimination of the unknowns of the rows.

    Args:
        lattice: control points; three rows of them form a block.
        products: (4, height, nx) weighted products of the derivatives with neighbouring splines, by components.
        reduced: (height, ROW_UNKNOWNS, 2 nx) coupling of the rows, multiplied by the factor of the inverse of their matrix.
    """
    (ny, nx), height, by = lattice.counts, lattice.shape[0], lattice.rows
    n, m = ny // 3, 6 * nx
    blocks = np.zeros((n + 1, 2, 2, 3, nx, 2, 3, nx))  # block row, own or next, component, row, column, ...
    spacing = lattice.spacing_px
    for j in range(ny):
        for e in range(min(4, ny - j)):
            first = max(0, int(np.floor((j + e - 3) * spacing)))
            last = min(height, int(np.ceil((j + 1) * spacing)) + 1)
            if first >= last:
                continue
            rows = slice(first, last)
            both = by[rows, j] * by[rows, j + e]
            z = reduced[rows].reshape(-1, 2 * nx)
            part = -((z * np.repeat(both, ROW_UNKNOWNS)[:, None]).T @ z).reshape(2, nx, 2, nx)
            for (a, b), q in products.items():
                sums = np.einsum("y,eyi->ei", both, q[:, rows])
                band = _banded(sums, nx)
                part[a, :, b, :] += band
                if a != b:
                    part[b, :, a, :] += band
            k, p = divmod(j, 3)
            k2, p2 = divmod(j + e, 3)
            if k2 == k:
                blocks[k, 0, :, p, :, :, p2, :] = part
                if e:
                    blocks[k, 0, :, p2, :, :, p, :] = part.transpose(2, 3, 0, 1)
            else:
                blocks[k, 1, :, p, :, :, p2, :] = part
    return blocks[:n].reshape(n, 2, m, m)


def _banded(sums: Array, n: int) -> Array:
    """Symmetric (n, n) matrix with four diagonals (4, n)."""
    out = np.zeros((n, n))
    for e in range(min(4, n)):
        at = np.arange(n - e)
        out[at, at + e] = sums[e, : n - e]
        out[at + e, at] = sums[e, : n - e]
    return out


def to_fields(lattice: Lattice, vector: Array) -> Array:
    """(2, ny, nx) coefficients of u and v of a vector (n, m)."""
    ny, nx = lattice.counts
    return vector.reshape(ny // 3, 2, 3, nx).transpose(1, 0, 2, 3).reshape(2, ny, nx)


def to_vector(lattice: Lattice, fields: Array) -> Array:
    """Inverse of `to_fields`."""
    ny, nx = lattice.counts
    return fields.reshape(2, ny // 3, 3, nx).transpose(1, 0, 2, 3).reshape(ny // 3, 6 * nx)


def row_unknowns(equations: Equations, lattice: Lattice, step: Array) -> tuple[Array, Array]:
    """Step (height, 4) of the unknowns of each row for a step (2, ny, nx) of the field, and their variances given the field."""
    at_rows = np.einsum("yj,cji->yci", lattice.rows, step)
    remaining = equations.row_right - np.einsum("yaci,yci->ya", equations.row_coupling, at_rows)
    inverse = np.linalg.inv(equations.row_matrix)
    return np.einsum("yab,yb->ya", inverse, remaining), np.einsum("yaa->ya", inverse)
