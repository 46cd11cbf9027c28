"""Displacement field of cubic B-splines on a uniform lattice of control points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROBUST_ITERATIONS = 15
MIN_SCALE_PX = 0.2  # of the distances that count as usual


def basis(positions_px: Array, spacing_px: float, count: int, derivative: int = 0) -> Array:
    """Values of the `count` cubic B-splines of a line at positions, (n, count), or of their derivative per px.

    Control point k lies at ``(k - 1) spacing``, so positions from 0 to ``(count - 3) spacing`` have four splines each.
    """
    t = positions_px / spacing_px
    cell = np.clip(np.floor(t).astype(np.intp), 0, count - 4)
    t = t - cell
    o = 1.0 - t
    if derivative == 0:
        w = np.stack([o**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * o**2 + 3.0 * o**3, t**3]) / 6.0
    elif derivative == 1:
        w = np.stack([-(o**2), t * (3.0 * t - 4.0), -o * (3.0 * o - 4.0), t**2]) / (2.0 * spacing_px)
    else:
        w = np.stack([o, 3.0 * t - 2.0, 3.0 * o - 2.0, t]) / spacing_px**2
    out = np.zeros((len(t), count))
    rows = np.arange(len(t))
    for k in range(4):
        out[rows, cell + k] = w[k]
    return out


@dataclass(frozen=True)
class Lattice:
    """Control points over a frame.

    Attributes:
        shape: (height, width) of the frame in px.
        spacing_px: distance of control points.
    """

    shape: tuple[int, int]
    spacing_px: float

    @cached_property
    def counts(self) -> tuple[int, int]:
        """Numbers of control points along y and x; along y a multiple of three."""
        ny, nx = (int(np.ceil((n - 1) / self.spacing_px)) + 3 for n in self.shape)
        return -(-max(ny, 6) // 3) * 3, nx

    @cached_property
    def rows(self) -> Array:
        """(height, ny) splines along y at the pixel rows."""
        return basis(np.arange(self.shape[0], dtype=float), self.spacing_px, self.counts[0])

    @cached_property
    def columns(self) -> Array:
        """(width, nx) splines along x at the pixel columns."""
        return basis(np.arange(self.shape[1], dtype=float), self.spacing_px, self.counts[1])

    @cached_property
    def bending(self) -> tuple[Array, Array]:
        """Bending energy of the area, integral of u_xx^2 + 2 u_xy^2 + u_yy^2 in 1/px^2 per px^2 of field.

        Blocks of three rows of control points: diagonal (n, m, m) and upper (n - 1, m, m), with m = 3 nx.
        """
        (ny, nx), h = self.counts, self.spacing_px
        along = {}
        for name, count in (("y", ny), ("x", nx)):
            # Gauss-Legendre, four points in each cell, is exact for products of cubic polynomials
            nodes, weights = np.polynomial.legendre.leggauss(4)
            at = ((np.arange(count - 3)[:, None] + 0.5 * (nodes + 1.0)) * h).ravel()
            w = np.tile(0.5 * h * weights, count - 3)
            along[name] = [(b := basis(at, h, count, d)).T @ (w[:, None] * b) for d in range(3)]
        (y0, y1, y2), (x0, x1, x2) = along["y"], along["x"]

        def block(a: int, b: int) -> Array:
            r, c = slice(3 * a, 3 * a + 3), slice(3 * b, 3 * b + 3)
            return np.kron(y0[r, c], x2) + 2.0 * np.kron(y1[r, c], x1) + np.kron(y2[r, c], x0)

        n = ny // 3
        return np.stack([block(k, k) for k in range(n)]), np.stack([block(k, k + 1) for k in range(n - 1)])

    def evaluate(self, c: Array) -> Array:
        """(height, width) field of the coefficients (ny, nx)."""
        return self.rows @ c @ self.columns.T

    def fitted(self, field: Array) -> Array:
        """(ny, nx) coefficients of the field closest to a field (height, width)."""
        left, right = (np.linalg.solve(b.T @ b + 1e-6 * np.eye(b.shape[1]), b.T) for b in (self.rows, self.columns))
        return left @ field @ right.T

    def smooth_through(self, matches: Array, smoothness: float) -> Array:
        """(2, ny, nx) coefficients of a smooth field through scattered displacements, robust against outliers.

        Args:
            matches: (n, 4) x, y, u, v in px.
            smoothness: weight of the bending energy relative to one match.
        """
        ny, nx = self.counts
        along_y, along_x = basis(matches[:, 1], self.spacing_px, ny), basis(matches[:, 0], self.spacing_px, nx)
        design = (along_y[:, :, None] * along_x[:, None, :]).reshape(len(matches), ny * nx)
        bending, bending_next = self.bending
        m, penalty = 3 * nx, np.zeros((ny * nx, ny * nx))
        for k in range(ny // 3):
            here, after = slice(k * m, (k + 1) * m), slice((k + 1) * m, (k + 2) * m)
            penalty[here, here] = bending[k]
            if k + 1 < ny // 3:
                penalty[here, after], penalty[after, here] = bending_next[k], bending_next[k].T
        weight = np.ones(len(matches))
        c = np.zeros((ny * nx, 2))
        for _ in range(ROBUST_ITERATIONS):
            matrix = design.T @ (weight[:, None] * design) + smoothness * penalty + 1e-6 * np.eye(ny * nx)
            c = np.asarray(np.linalg.solve(matrix, design.T @ (weight[:, None] * matches[:, 2:])), dtype=np.float64)
            distance = np.linalg.norm(matches[:, 2:] - design @ c, axis=1)
            scale = max(2.0 * 1.48 * float(np.median(distance)), MIN_SCALE_PX)
            weight = (1.0 + (distance / scale) ** 2) ** -2
        return np.asarray(c.T.reshape(2, ny, nx), dtype=np.float64)
