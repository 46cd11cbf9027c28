"""Whitening of residuals: removal of the noise of frame 0 and of the correlation between overlapping subsets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.estimate.joint.observations.block_means import blocks_of
from semlive.kernels.linear_algebra import cholesky, forward_substitution
from semlive.mechanics.correlation_length import correlation_of, window_correlation

OTHER_LENGTHS, OTHER_WINDOWS = 6, (0.0, 0.45, 1.0)  # lengths beyond the subset, and Gaussian shares of windows
# Log odds of another window against a square one of at most the subset: independent points instead of a correlation of 0.4 between
# neighbours lose 0.1 for each number; the small differences between windows of one area do not matter for a verdict.
MIN_WINDOW_ODDS, MIN_WINDOW_ODDS_PER_NUMBER = 10.0, 0.01
LENGTHS = 9  # number of candidate correlation lengths, from the distance of points to the subset size
MAX_MAPS, MAX_POINTS = 8, 100_000  # in the estimate of the window from points: one second of processor time


@dataclass(frozen=True, slots=True)
class Window:
    """Correlation of the noise over points.

    Attributes:
        length_px: correlation length: the subset edge for overlapping subsets, or the step for independent points, px.
        gaussian: share of a Gaussian in the window of the subsets, 0 to 1; see `window_correlation`.
        own: fraction of the variance that each point has for itself.
    """

    length_px: float
    gaussian: float = 0.0
    own: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Whitens fields over frames and blocks.

    Attributes:
        factor: (b, b) lower Cholesky factor of the correlation of block means.
        inverse: (b, b) inverse factor. Multiplying with it takes a third of the time of a triangular solution.
        sigma_px: standard deviation of the block mean of one frame, px.
        over_frames: for x and for y, (f, f) inverse lower factor of the covariance of the frames' noise, in units of `sigma_px`; None if
            frames have equal and independent noise.
    """

    factor: NDArray[np.float64]
    inverse: NDArray[np.float64]
    sigma_px: float
    over_frames: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def __call__(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """(f, b, 2, ...) fields in units of the noise, without what the noise of frame 0 makes unobservable.

        The reference address p_b of each block is a free parameter. The result has one independent number per block fewer than the input.
        """
        if self.over_frames is not None:
            return np.stack([self.one_axis(axis, field[:, :, axis]) for axis in (0, 1)], axis=2)
        return self.one_axis(0, field)

    def one_axis(self, axis: int, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """(f, b, ...) fields along one axis, whitened likewise."""
        return np.asarray(self.without_reference(axis, self.unprojected(axis, field)))

    def unprojected(self, axis: int, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """(f, b, ...) fields along one axis in units of the noise, frame 0 taken as free of noise."""
        white = np.matmul(self.inverse / self.sigma_px, field.reshape(*field.shape[:2], math.prod(field.shape[2:])))
        if self.over_frames is not None:
            white = np.tensordot(self.over_frames[axis], white, 1)
        return np.asarray(white.reshape(field.shape), dtype=np.float64)

    def rows(self, axis: int, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, f, b) contiguous fields along one axis, whitened likewise."""
        white = np.matmul(rows, self.inverse.T / self.sigma_px)
        if self.over_frames is None:
            white -= white.mean(axis=1, keepdims=True)
            return np.asarray(white)
        white = np.matmul(self.over_frames[axis], white)
        free = self._free(axis)
        return np.asarray(white - free[:, None] * np.einsum("f,kfb->kb", free, white)[:, None])

    def adjoint(self, axis: int, white: NDArray[np.float64]) -> NDArray[np.float64]:
        """(f b, k) fields whose products with fields in px are those of the given ones, (f b, k), with the same fields whitened."""
        columns = white.reshape(len(white) // len(self.factor), len(self.factor), white.shape[-1])
        if self.over_frames is None:
            columns = columns - columns.mean(axis=0)
        else:
            free = self._free(axis)
            columns = columns - np.multiply.outer(free, np.tensordot(free, columns, 1))
            columns = np.tensordot(self.over_frames[axis].T, columns, 1)
        return np.asarray(np.matmul(self.inverse.T / self.sigma_px, columns).reshape(white.shape))

    def without_reference(self, axis: int, white: NDArray[np.float64]) -> NDArray[np.float64]:
        """(f, ...) fields along one axis in units of the noise, minus the part of a displacement equal in all frames. In place."""
        if self.over_frames is None:
            white -= white.mean(axis=0)
        else:
            free = self._free(axis)
            white -= np.multiply.outer(free, np.tensordot(free, white, 1))
        return white

    @property
    def half_log_det(self) -> float:
        """Half the log determinant of the covariance of both components, without the free reference address."""
        frames = 0.0
        if self.over_frames is not None:
            for inverse in self.over_frames:
                free = inverse.sum(axis=1)
                frames += 0.5 * math.log(float(free @ free) / len(free)) - float(np.sum(np.log(np.diag(inverse))))
        return frames * len(self.factor)

    def _free(self, axis: int) -> NDArray[np.float64]:
        """(f,) unit vector of a displacement equal in all frames."""
        assert self.over_frames is not None  # without, it is the mean
        free = self.over_frames[axis].sum(axis=1)
        return np.asarray(free / np.linalg.norm(free))


def make_whitener(grid: Grid, used: NDArray[np.int64], window: Window, sigma_px: float, max_blocks: int = 0) -> Whitener:
    """Whitener for noise seen through a window.

    Args:
        grid: grid of the points.
        used: (b,) indices of the used blocks.
        window: correlation of the noise over points.
        sigma_px: standard deviation of the block mean of one frame, px.
        max_blocks: largest number of blocks of the estimate.
    """
    factor = _factor(grid, used, window, max_blocks)
    return Whitener(factor, forward_substitution(factor, np.eye(len(factor))), sigma_px)


def _factor(grid: Grid, used: NDArray[np.int64], window: Window, max_blocks: int) -> NDArray[np.float64]:
    """(b, b) lower Cholesky factor of the correlation of block means."""
    correlation = block_correlation(grid, window, max_blocks)[np.ix_(used, used)]
    root = np.sqrt(np.diag(correlation))
    return cholesky(correlation / np.outer(root, root))


def block_correlation(grid: Grid, window: Window, max_blocks: int = 0) -> NDArray[np.float64]:
    """(blocks, blocks) covariance of the means of all blocks' points, in units of one point's variance."""
    blocks = blocks_of(grid, max_blocks)
    rows, columns = blocks.layout
    block = blocks.block.reshape(grid.shape)
    along = _along(grid.y_px, block[:, 0] // columns, rows, window), _along(grid.x_px, block[0], columns, window)
    correlation = (1.0 - window.own) * np.kron(*along)
    correlation[np.diag_indices_from(correlation)] += window.own / np.bincount(blocks.block)
    return np.asarray(correlation, dtype=np.float64)


def window_of_points(maps: Sequence[DisparityMap]) -> Window | None:
    """Window that the variogram of some of the maps within pairs over neighbouring points gives; None for independent points.

    Only the variogram determines what each point has for itself: a smooth effect adds nothing at the distance of neighbours.
    """
    if not maps:
        return None
    most = min(max(MAX_POINTS // maps[0].status.size, 2), MAX_MAPS)
    found = correlation_of(maps[:: math.ceil(len(maps) / most)])
    return Window(found.window_px, found.gaussian, found.own_fraction) if found is not None and found.edge_px else None


def most_likely_window(
    grid: Grid,
    used: NDArray[np.int64],
    residual: NDArray[np.float64],
    rough: NDArray[np.float64],
    of_points: Window | None = None,
    max_blocks: int = 0,
) -> Window:
    """Window that maximises the likelihood of the rough part of residuals (f, b, 2).

    The window of the points comes first: there are many more of them than blocks. Where the blocks contradict it, lengths up to the subset
    edge with a square window are next. Other windows and greater lengths, as in maps that were smoothed or were imported without their
    subset, are taken only where the data are much more likely.

    Args:
        grid: grid of the points.
        used: (b,) indices of the used blocks.
        residual: (f, b, 2) residuals, px.
        rough: (b, k) columns that span the rough part.
        of_points: window from neighbouring points, if there is one.
        max_blocks: largest number of blocks of the estimate.
    """
    longest = float(max(grid.subset_px, grid.step_px))
    flat = rough.T @ np.moveaxis(residual, 1, 0).reshape(residual.shape[1], -1)

    @cache
    def score(window: Window) -> float:
        try:
            factor = rough_cholesky(_factor(grid, used, window, max_blocks), rough)
        except np.linalg.LinAlgError:  # a window much longer than the blocks: singular in double precision
            return -np.inf
        white = forward_substitution(factor, flat)
        volume = flat.shape[1] * float(np.sum(np.log(np.diag(factor))))
        return -0.5 * white.size * float(np.log(float(np.mean(white**2)) or 1e-300)) - volume

    usual = max((Window(float(length_px)) for length_px in np.unique(np.linspace(grid.step_px, longest, LENGTHS))), key=score)
    field_px = min(float(np.ptp(grid.x_px)), float(np.ptp(grid.y_px)))
    beyond = np.geomspace(longest, max(field_px / 4.0, 1.1 * longest), OTHER_LENGTHS).tolist()
    lengths_px = (0.5 * longest, 0.75 * longest, *beyond)
    other = max((Window(length_px, gaussian) for gaussian in OTHER_WINDOWS for length_px in lengths_px), key=score)
    odds = MIN_WINDOW_ODDS + MIN_WINDOW_ODDS_PER_NUMBER * flat.size
    best = other if score(other) > score(usual) + odds else usual
    return best if of_points is None or score(of_points) < score(best) - MIN_WINDOW_ODDS else of_points


def rough_cholesky(factor: NDArray[np.float64], rough: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, k) lower Cholesky factor, in the space of (b, k) orthonormal columns, of noise with a (b, b) factor of its correlation."""
    half = rough.T @ factor
    return cholesky(half @ half.T)


def _along(position: NDArray[np.float64], member: NDArray[np.int64], count: int, window: Window) -> NDArray[np.float64]:
    """(count, count) mean correlation between the points of each two groups along one axis, without the points' own noise."""
    distance_px, length_px = np.abs(np.subtract.outer(position, position)), window.length_px
    close = (
        window_correlation(distance_px, length_px, window.gaussian)
        if window.gaussian
        else np.clip(1.0 - distance_px / length_px, 0.0, None)
    )
    share = (member[None, :] == np.arange(count)[:, None]).astype(np.float64)
    share /= share.sum(axis=1, keepdims=True)
    return np.asarray(share @ close @ share.T, dtype=np.float64)
