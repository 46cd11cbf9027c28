"""Blocks of POI: overlapping subsets averaged until their noise is nearly white."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve

from semlive.data.grid import Grid
from semlive.estimate.storage import Storage
from semlive.kernels.linear_algebra import cholesky
from semlive.kernels.splines.spline_columns import local_sums, tensor_sums
from semlive.model import Axis, Columns, TensorColumns

OUTLIER_MAD_FACTOR = 6.0  # a displacement gradient alone reaches 2 median absolute deviations within a block
OUTLIER_FLOOR_PX = 0.05
BEND, BEND_PASSES = 6, 8  # total order of the polynomials that a map is smooth by; a wrong corner bends them by half of itself at first
WELL_DETERMINED = 1e-3  # smallest relative pivot with which normal equations lose at most half of the digits
ISOLATION_FACTOR = 8.0  # times what neighbours usually differ by: 5.4 standard deviations of a difference
SMALL_BLOCK_POINTS = (
    4  # points of a block, of which a gradient alone puts half far off the other half: with points 25 px apart 0.3 % of strain did
)
ENOUGH_BLOCKS = 272
_ALIGNED = 8  # array elements of 8 bytes (64 bytes)


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """A partition of the grid into blocks as large as a subset.

    Noise of neighbouring POI is shared over a subset, so N points are worth about N (step / subset)^2 independent ones (272 of the
    paper's 18,000). One block counts as one: it gets the variance that is right for everything slower than a subset,
    ``sigma^2 subset^2 / area``, although block means taken alone scatter less (`block_variance_ratio`), because neighbouring blocks still
    share a part of their noise.

    Attributes:
        shape: (ny, nx) of the grid.
        block: (points,) number of the block that each POI is in.
        members: (blocks, most) POI of each block, padded with -1.
        effective_points: number of POI that together are worth one independent point, (subset / step)^2.
        block_variance_ratio: variance of a full block's mean relative to the assigned one (below 1 where subsets overlap).
    """

    shape: tuple[int, int]
    block: NDArray[np.int64]
    members: NDArray[np.int64]
    effective_points: float
    block_variance_ratio: float

    @classmethod
    def of(cls, grid: Grid, most: int = 0) -> Blocks:
        """Partition a grid into blocks with the edge of a subset, or of one POI where subsets do not overlap.

        Args:
            grid: grid of the points.
            most: largest number of blocks, about; with more, all blocks are larger. 0: no limit.
        """
        points = max(1, math.ceil(grid.subset_px / grid.step_px))
        # results of another DIC engine without a subset size: as many blocks as with subsets of 43 px and 18,000 points
        if grid.subset_px == 0:
            points = max(1, round(math.sqrt(grid.nx * grid.ny / ENOUGH_BLOCKS)))
        if most:
            points = max(points, math.ceil(math.sqrt(grid.nx * grid.ny / most)))
        along_x, along_y = _split(grid.nx, points), _split(grid.ny, points)
        block = along_y[:, None] * (along_x[-1] + 1) + along_x[None, :]
        flat = block.ravel()
        count = np.bincount(flat)
        order = np.argsort(flat, kind="stable")
        members = np.full((len(count), count.max()), -1, dtype=np.int64)
        slot = np.arange(len(flat)) - np.repeat(np.cumsum(count) - count, count)
        members[flat[order], slot] = order
        reach = max(grid.subset_px, grid.step_px)
        shared = (reach / grid.step_px) ** 2
        lag = np.abs(np.subtract.outer(np.arange(points), np.arange(points))) * grid.step_px / reach
        mean_correlation = float(np.clip(1.0 - lag, 0.0, None).mean())
        return cls(grid.shape, flat, members, shared, mean_correlation**2 / min(1.0, shared / points**2))

    @property
    def size(self) -> int:
        """Number of blocks."""
        return len(self.members)

    @property
    def layout(self) -> tuple[int, int]:
        """(rows, columns) of blocks."""
        columns = int(self.block[self.shape[1] - 1]) + 1
        return self.size // columns, columns

    @property
    def full_count(self) -> NDArray[np.int64]:
        """(blocks,) number of POI in each block."""
        return (self.members >= 0).sum(axis=1)

    def variance(self, count: NDArray[np.int64]) -> NDArray[np.float64]:
        """Variance assigned to the mean of `count` POI of a block, in units of the variance of one POI."""
        return np.minimum(1.0, self.effective_points / np.maximum(count, 1))

    def inliers(self, value: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(points,) valid POI close to the median of their block, for one component (points,).

        Blocks of one POI are compared with a neighbour.
        """
        if self.members.shape[1] == 1:
            return valid & ~isolated_outliers(value.reshape(self.shape), valid.reshape(self.shape)).ravel()
        if self.members.shape[1] <= SMALL_BLOCK_POINTS:
            value = _level(value.reshape(self.shape), valid.reshape(self.shape)).ravel()
        padded = np.where((self.members >= 0) & valid[self.members], value[self.members], np.inf)
        padded.sort(axis=1)
        count = np.isfinite(padded).sum(axis=1)
        rows = np.arange(self.size)
        middle = np.where(count > 0, padded[rows, np.maximum(count - 1, 0) // 2], 0.0)
        deviation = np.where(np.isfinite(padded), np.abs(padded - middle[:, None]), np.inf)
        deviation.sort(axis=1)
        spread = np.where(count > 0, deviation[rows, np.maximum(count - 1, 0) // 2], 0.0)
        limit = OUTLIER_MAD_FACTOR * 1.4826 * spread + OUTLIER_FLOOR_PX
        return valid & (np.abs(value - middle[self.block]) <= limit[self.block])

    def mean(self, value: NDArray[np.float64], used: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(blocks, ...) mean over the used POI of each block of values (points, ...); zero for an empty block."""
        at = self.block[used]
        count = np.maximum(np.bincount(at, minlength=self.size), 1)
        if value.ndim == 1:
            return np.bincount(at, value[used], self.size) / count
        return np.stack([np.bincount(at, column, self.size) / count for column in value[used].T], axis=1)


def _level(value: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(ny, nx) a component minus its median slopes along x and y."""
    finite = np.where(valid, value, np.nan)
    across, down = (np.diff(finite, axis=axis) for axis in (1, 0))
    slopes = [float(np.median(value[np.isfinite(value)])) if np.isfinite(value).any() else 0.0 for value in (across, down)]
    height, width = value.shape
    return value - slopes[0] * np.arange(width) - slopes[1] * np.arange(height)[:, None]


def isolated_outliers(value: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find valid POI that differ strongly from each of their eight neighbours.

    The comparison uses the residual of a component after removal of a smooth polynomial. A real displacement step, such as a jump between
    two rows or a slip line, moves at least one neighbour as well and is therefore not marked.

    Args:
        value: (ny, nx) one displacement component, px.
        valid: (ny, nx) True where the component is valid.

    Returns:
        (ny, nx) True for isolated outliers.
    """
    height, width = value.shape
    padded = np.full((height + 2, width + 2), np.nan)
    inside = np.full(value.shape, np.nan)
    inside[valid] = _unbent(value, valid)
    padded[1:-1, 1:-1] = inside
    ways = [(dy, dx) for dy in (0, 1, 2) for dx in (0, 1, 2) if (dy, dx) != (1, 1)]
    distance = np.stack([np.abs(inside - padded[dy : dy + height, dx : dx + width]) for dy, dx in ways])
    defined = np.isfinite(distance)
    if not defined.any():
        return np.zeros_like(valid)
    nearest = np.where(defined, distance, np.inf).min(axis=0)
    return np.isfinite(nearest) & (nearest > ISOLATION_FACTOR * np.median(distance[defined]) + OUTLIER_FLOOR_PX)


def _unbent(value: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n,) residual of the valid POI after a robust polynomial fit (least absolute deviations), which a single outlier does not bend."""
    order = np.arange(BEND + 1)
    shapes = _polynomials(*value.shape)[valid][:, np.add.outer(order, order).ravel() <= BEND]
    samples, weight = value[valid], np.ones(int(valid.sum()))
    residual = samples
    for _ in range(BEND_PASSES):
        residual = samples - shapes @ _least_squares(shapes * weight[:, None], samples * weight)
        weight = 1.0 / np.sqrt(np.maximum(np.abs(residual), OUTLIER_FLOOR_PX))
    return residual


def _least_squares(design: NDArray[np.float64], samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) solution of an overdetermined system; the one of smallest norm if it is not unique.

    The normal equations take a fifth of the time of a singular value decomposition (180 points: 26 instead of 126 microseconds).
    """
    with contextlib.suppress(LinAlgError):
        factor = cholesky(design.T @ design)
        pivots = np.diagonal(factor)
        if pivots.min() > WELL_DETERMINED * pivots.max():
            return np.asarray(cho_solve((factor, True), design.T @ samples, check_finite=False))
    return np.asarray(np.linalg.lstsq(design, samples, rcond=None)[0], dtype=np.float64)


@lru_cache(maxsize=2)
def _polynomials(height: int, width: int) -> NDArray[np.float64]:
    """(ny, nx, m) products of Legendre polynomials of x and of y over a grid, the same for all maps of a run."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height))
    return np.polynomial.legendre.legvander2d(x, y, (BEND, BEND)).astype(np.float64, copy=False)


@dataclass(frozen=True, slots=True, eq=False)
class BlockColumns:
    """Block means of the columns of an effect, dense over the parameters they touch.

    Attributes:
        effect: name of the effect.
        axis: the component acted on.
        index: (m,) indices within the effect's parameters (see Axis.EACH).
        value: (blocks, m) block means.
    """

    effect: str
    axis: Axis
    index: NDArray[np.int64]
    value: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PackedColumns:
    """Block means of the columns of a surface, stored only where each block touches them. Needs a quarter of the memory.

    Attributes:
        effect: name of the effect.
        shape: (ny, nx) of the coefficients.
        low: (blocks, 2) first coefficient that each block touches, along y and along x.
        window: (blocks, wy, wx) block means from there on.
    """

    effect: str
    shape: tuple[int, int]
    low: NDArray[np.int64]
    window: NDArray[np.float64]

    @classmethod
    def of(cls, columns: BlockColumns, shape: tuple[int, int]) -> PackedColumns:
        """Pack the columns of all coefficients of a surface of the given shape."""
        full = columns.value.reshape(-1, *shape)
        touched = full != 0.0
        lows, widths = [], []
        for axis, count in enumerate(shape):
            along = touched.any(axis=2 - axis)
            first, last = along.argmax(axis=1), np.where(along.any(axis=1), count - along[:, ::-1].argmax(axis=1), 0)
            widths.append(int(np.max(last - first, initial=1)))
            lows.append(np.minimum(first, count - widths[-1]))
        rows, columns_at = (low[:, None] + np.arange(width) for low, width in zip(lows, widths, strict=True))
        window = full[np.arange(len(full))[:, None, None], rows[:, :, None], columns_at[:, None, :]]
        return cls(columns.effect, shape, np.stack(lows, axis=1), window)

    def unpacked(self) -> BlockColumns:
        """Columns dense over all coefficients."""
        blocks, height, width = self.window.shape
        pitch, size = self.shape[1], self.shape[0] * self.shape[1]
        total = np.zeros(blocks * size)
        # One index for each element takes a third of the time of one for each axis.
        first = size * np.arange(blocks) + pitch * self.low[:, 0] + self.low[:, 1]
        within = pitch * np.arange(height)[:, None] + np.arange(width)
        total[np.add.outer(first, within.ravel()).ravel()] = self.window.ravel()
        return BlockColumns(self.effect, Axis.EACH, np.arange(size), total.reshape(blocks, size))


@dataclass(frozen=True, slots=True, eq=False)
class StoredColumns:
    """Columns of one map in two arrays owned by a `Storage`. Saves about ten objects of 0.4 kB for every map of a run.

    Attributes:
        labels: for each column block, the effect and the component or the shape of its coefficients.
        offsets: (p,) for each column block, its sizes followed by the indices of the coefficients.
        value: (v,) block means, each array aligned to 64 bytes, because the result of a sum may depend on alignment.
    """

    labels: tuple[tuple[str, Axis | tuple[int, int]], ...]
    offsets: NDArray[np.int64]
    value: NDArray[np.float64]

    @classmethod
    def of(cls, columns: Sequence[BlockColumns | PackedColumns], storage: Storage) -> StoredColumns:
        """Store columns in `storage`."""
        kinds, places, values = [], list[NDArray[np.int64]](), list[NDArray[np.float64]]()
        for column in columns:
            if isinstance(column, PackedColumns):
                kinds.append((column.effect, column.shape))
                sizes, at, value = column.window.shape, column.low.ravel(), column.window
            else:
                kinds.append((column.effect, column.axis))
                sizes, at, value = (*column.value.shape, 0), column.index, column.value
            places += [np.array(sizes, dtype=np.int64), at]
            values += [value.ravel(), np.zeros(-value.size % _ALIGNED)]
        return cls(_shared(tuple(kinds)), storage.store_array(np.concatenate(places)), storage.store_array(np.concatenate(values)))

    def columns(self) -> Iterator[BlockColumns | PackedColumns]:
        """Yield the stored columns in their original form."""
        at = begin = 0
        for effect, how in self.labels:
            blocks, first, second = (int(offset) for offset in self.offsets[at : at + 3])
            shape = (blocks, first) if isinstance(how, Axis) else (blocks, first, second)
            count, size = first if isinstance(how, Axis) else 2 * blocks, math.prod(shape)
            where = self.offsets[at + 3 : at + 3 + count]
            value = self.value[begin : begin + size].reshape(shape)
            at, begin = at + 3 + count, begin + size + -size % _ALIGNED
            if isinstance(how, Axis):
                yield BlockColumns(effect, how, where, value)
            else:
                yield PackedColumns(effect, how, where.reshape(-1, 2), value)


@lru_cache(maxsize=64)
def _shared(kinds: tuple[tuple[str, Axis | tuple[int, int]], ...]) -> tuple[tuple[str, Axis | tuple[int, int]], ...]:
    return kinds


def block_columns(effect: str, columns: Columns | TensorColumns, block: NDArray[np.int64], blocks: int, sign: float = 1.0) -> BlockColumns:
    """Average columns (n, k) over blocks; `block` (n,) is the block of each row."""
    count = np.maximum(np.bincount(block, minlength=blocks), 1)[:, None]
    if isinstance(columns, TensorColumns):
        along_y, along_x = (columns.index_y, columns.value_y), (columns.index_x, columns.value_x)
        total = tensor_sums(block, blocks, *along_y, *along_x, columns.shape).reshape(blocks, -1)
        return BlockColumns(effect, columns.axis, np.arange(total.shape[1]), _mean(total, count, sign))
    low = int(columns.index.min())
    span = int(columns.index.max()) - low + 1
    index, value = np.ascontiguousarray(columns.index), np.ascontiguousarray(columns.value)  # some arrays are one broadcast row
    total = local_sums(block, blocks, index, value, low, span)
    return BlockColumns(effect, columns.axis, np.arange(low, low + span), _mean(total, count, sign))


def own_columns(effect: str, columns: Columns) -> BlockColumns:
    """Columns whose rows (n, k) are the blocks themselves.

    Most of these are the same parameters in every row, which need no sum: summing them took a tenth of the time of a live estimate.
    """
    index, value = columns.index, columns.value
    if not len(index) or not index.shape[1] or index.strides[0] or not _ascends(index[0]):
        return block_columns(effect, columns, np.arange(len(value)), len(value))
    low = int(index[0, 0])
    total = np.zeros((len(value), int(index[0, -1]) + 1 - low))
    total[:, contiguous_slice(index[0] - low)] = value
    return BlockColumns(effect, columns.axis, np.arange(low, low + total.shape[1]), total)


def _mean(total: NDArray[np.float64], count: NDArray[np.int64], sign: float) -> NDArray[np.float64]:
    total /= count
    return np.negative(total, out=total) if sign < 0 else total


def contiguous_slice(places: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Convert distinct indices to a slice if they are consecutive and ascending. Indexing with a slice is four times as fast."""
    ahead = len(places) - 1
    if ahead >= 0 and places[-1] - places[0] == ahead and _ascends(places):
        return slice(int(places[0]), int(places[-1]) + 1)
    return places


blocks_of = lru_cache(maxsize=4)(Blocks.of)
"""Blocks of a grid; the same object for the same grid."""


def _ascends(places: NDArray[np.int64]) -> bool:
    return bool((places[1:] > places[:-1]).all())  # a quarter of the time of `np.diff`


def _split(count: int, points: int) -> NDArray[np.int64]:
    """(count,) number of the block of each point: blocks of `points` points, as equal as possible."""
    blocks = max(1, round(count / points))
    return (np.arange(count) * blocks // count).astype(np.int64)
