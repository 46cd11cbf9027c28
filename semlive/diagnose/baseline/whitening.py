"""Whitening of residuals: removal of the noise of frame 0 and of the correlation between overlapping subsets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from semlive.data.grid import Grid
from semlive.estimate.joint.observations.block_means import Blocks

LENGTHS = 9  # number of candidate correlation lengths, from the distance of points to the subset size


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Whitens fields over frames and blocks.

    Attributes:
        factor: (b, b) lower Cholesky factor of the correlation of block means.
        inverse: (b, b) inverse factor. Multiplying with it takes a third of the time of a triangular solution.
        sigma_px: standard deviation of the block mean of one frame, px.
    """

    factor: NDArray[np.float64]
    inverse: NDArray[np.float64]
    sigma_px: float

    def __call__(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """(f, b, ...) fields in units of the noise, minus their mean over the frames, which the noise of frame 0 makes unobservable.

        The reference address p_b of each block is a free parameter. The result has one independent number per block fewer than the input.
        """
        white = np.matmul(self.inverse / self.sigma_px, field.reshape(*field.shape[:2], math.prod(field.shape[2:])))
        white -= white.mean(axis=0)
        return np.asarray(white.reshape(field.shape))

    def rows(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, f, b) contiguous fields, whitened likewise."""
        white = np.matmul(rows, self.inverse.T / self.sigma_px)
        white -= white.mean(axis=1, keepdims=True)
        return np.asarray(white)


def make_whitener(grid: Grid, used: NDArray[np.int64], length_px: float, sigma_px: float) -> Whitener:
    """Whitener for noise with a triangular autocorrelation of a given length along x and y.

    Args:
        grid: grid of the points.
        used: (b,) indices of the used blocks.
        length_px: correlation length: the subset edge for overlapping subsets, or the step for independent points, px.
        sigma_px: standard deviation of the block mean of one frame, px.
    """
    correlation = block_correlation(grid, length_px)[np.ix_(used, used)]
    root = np.sqrt(np.diag(correlation))
    factor = np.asarray(np.linalg.cholesky(correlation / np.outer(root, root)), dtype=np.float64)
    inverse = solve_triangular(factor, np.eye(len(factor)), lower=True, check_finite=False)
    return Whitener(factor, np.asarray(inverse), sigma_px)


def block_correlation(grid: Grid, length_px: float) -> NDArray[np.float64]:
    """(blocks, blocks) covariance of the means of all blocks' points, in units of one point's variance."""
    blocks = Blocks.of(grid)
    rows, columns = blocks.layout
    block = blocks.block.reshape(grid.shape)
    correlation = np.kron(_along(grid.y_px, block[:, 0] // columns, rows, length_px), _along(grid.x_px, block[0], columns, length_px))
    return np.asarray(correlation, dtype=np.float64)


def most_likely_length_px(grid: Grid, used: NDArray[np.int64], residual: NDArray[np.float64], rough: NDArray[np.float64]) -> float:
    """Correlation length that maximises the likelihood of the rough part of residuals (f, b, 2); columns (b, k) span the rough part."""
    longest = float(max(grid.subset_px, grid.step_px))
    best, best_length_px = -np.inf, longest
    flat = np.moveaxis(residual, 1, 0).reshape(residual.shape[1], -1)
    for length_px in np.unique(np.linspace(grid.step_px, longest, LENGTHS)):
        factor = rough_cholesky(make_whitener(grid, used, float(length_px), 1.0), rough)
        white = solve_triangular(factor, rough.T @ flat, lower=True, check_finite=False)
        score = -0.5 * white.size * np.log(float(np.mean(white**2))) - flat.shape[1] * float(np.sum(np.log(np.diag(factor))))
        if score > best:
            best, best_length_px = score, float(length_px)
    return best_length_px


def rough_cholesky(whiten: Whitener, rough: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, k) lower Cholesky factor of the noise's correlation in the space of (b, k) orthonormal columns."""
    half = rough.T @ whiten.factor
    return np.asarray(np.linalg.cholesky(half @ half.T), dtype=np.float64)


def _along(position: NDArray[np.float64], member: NDArray[np.int64], count: int, length_px: float) -> NDArray[np.float64]:
    """(count, count) mean of a triangular correlation between the points of each two groups along one axis."""
    close = np.clip(1.0 - np.abs(np.subtract.outer(position, position)) / length_px, 0.0, None)
    share = (member[None, :] == np.arange(count)[:, None]).astype(np.float64)
    share /= share.sum(axis=1, keepdims=True)
    return np.asarray(share @ close @ share.T, dtype=np.float64)
