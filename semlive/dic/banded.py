"""Correlation of frames of any size in bounded memory: bands of full width one after the other, then one outlier test of the map.

A band is correlated with additional rows of points on each side, as many as retries can reach. The result is therefore bit-identical
to that of the complete frame. Only in frames with edges above MAX_UNDIVIDED_PX the initial guesses differ, because they are computed
cell by cell. Images and mask may be memory maps; only bands of them are read.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.correlate import MAX_PASSES, ORDER, point_measurements, solve, to_disparity_map
from semlive.dic.initial_guess.fields import residual_affine_field, smooth_field
from semlive.dic.initial_guess.search import InitialGuessReference, match, prepare_coarse
from semlive.dic.outlier_rejection import PointMeasurements
from semlive.dic.reference import FrameStatistics, central_region, frame_statistics, prepare_part, usable_mask
from semlive.errors import BadInput
from semlive.kernels import images, interface

# Pixels of a band: 0.8 GB with gradients, coefficients and padded copies. Bands overlap by 347 px at a step of 8 px, 555 at 16: therefore
# pixels of a frame of 16384 px are processed 1.5 and 2.1 times; with bands of 12e6 px, 1.9 and 4.2 times.
BAND_PX = 18_000_000
BAND_POINTS = 400_000  # points of a band: 0.3 GB with their matrices
MAX_UNDIVIDED_PX = 4096  # edge of frames whose initial guesses are computed at once, not cell by cell
CELL_PX = 2048
CELL_MARGIN_PX = 192
FIELD_MARGIN_PX = 300  # four times the width over which initial guesses are smoothed
MARGIN_PX = 48  # around the subsets of a band at their initial guesses
SPLINE_PX = 24  # distance at which the boundary changes spline coefficients by less than the float32 resolution
SLICE_ROWS = 1024  # rows that are read at once to evaluate a complete image
HALO = MAX_PASSES + 1

Image = NDArray[np.uint8] | NDArray[np.uint16]


def is_large(shape: tuple[int, ...], grid: Grid) -> bool:
    """Whether a frame or grid is processed in bands, because processing it at once would need more than 1 GB."""
    return shape[0] * shape[1] > MAX_UNDIVIDED_PX**2 or grid.nx * grid.ny > BAND_POINTS


def correlate_tiled(
    reference: Image,
    current: Image,
    grid: Grid,
    settings: DicSettings,
    *,
    mask: NDArray[np.bool_] | None = None,
    reference_frame: int = 0,
    current_frame: int = 1,
    band_px: int = BAND_PX,
    band_points: int = BAND_POINTS,
) -> DisparityMap:
    """Disparity of two images of any size: the result of `correlate` with the method ``subset``, band by band.

    Args:
        reference: (height, width) uint8 or uint16, an array or a memory map.
        current: of the same size and type.
        grid: grid of the points, from `grid_for`.
        settings: as for `prepare`.
        mask: (height, width) True where the reference may be used; None: everywhere.
        reference_frame: number of the reference frame.
        current_frame: number of the current frame.
        band_px: pixels of a band.
        band_points: points of a band.

    Raises:
        BadInput: the images differ in size, grid and settings in the subset, or the mask has another size than the images; the settings
            demand the global method.
    """
    if settings.method == "global":
        raise BadInput(
            f"the global method is limited to {MAX_UNDIVIDED_PX} x {MAX_UNDIVIDED_PX} px and {BAND_POINTS} points: "
            "reduce the frame or the number of points, or use the method subset"
        )
    if reference.shape != current.shape:
        (h0, w0), (h1, w1) = reference.shape, current.shape
        raise BadInput(f"the reference is {w0} x {h0} px but the current image {w1} x {h1} px: give two images of one size")
    if grid.subset_px != settings.subset_px:
        raise BadInput(f"the grid was made for subsets of {grid.subset_px} px, the settings have {settings.subset_px}: make a new grid")
    if mask is not None and mask.shape != reference.shape:
        (h0, w0), (h1, w1) = mask.shape, reference.shape
        raise BadInput(f"the mask is {w0} x {h0} px but the images {w1} x {h1} px: give a mask of their size")
    mask = None if mask is None or mask.all() else mask
    pair = _Pair(reference, current, mask, _mean(reference, mask), _mean(current, None))
    statistics = pair.statistics()
    matches, ambiguous = initial_guesses(pair, grid, settings.search_px)
    undivided = max(reference.shape) <= MAX_UNDIVIDED_PX and len(matches) > 0
    guess = smooth_field(matches, grid) if undivided else None
    second_field = residual_affine_field(matches, grid) if undivided else None
    merged = _empty(grid)
    for first, last in bands(grid, reference.shape, band_px, band_points):
        low, high = max(first - HALO, 0), min(last + HALO, grid.ny)
        rows = dataclasses.replace(grid, y0_px=grid.y0_px + low * grid.step_px, ny=high - low)
        seeds = guess[low:high] if guess is not None else _local_field(matches, rows)
        second = None if second_field is None else second_field[low:high]
        part = _band(pair, rows, (seeds, second), matches, ambiguous[low:high], statistics, settings)
        for field in dataclasses.fields(PointMeasurements):
            getattr(merged, field.name)[first:last] = getattr(part, field.name)[first - low : last - low]
    return to_disparity_map(merged, grid, settings, reference_frame=reference_frame, current_frame=current_frame)


def _mean(image: Image, mask: NDArray[np.bool_] | None) -> np.float32:
    """Mean grey level of the unmasked part of an image, as in `prepare`."""
    if mask is None:
        return np.float32(image.mean())
    total = count = 0
    for first in range(0, image.shape[0], SLICE_ROWS):
        rows = slice(first, first + SLICE_ROWS)
        total += int(image[rows].sum(dtype=np.int64, where=mask[rows]))
        count += int(np.count_nonzero(mask[rows]))
    return np.float32(total / count if count else 0.0)


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two images, the mask of the first (None: no mask), and their mean grey levels."""

    reference: Image
    current: Image
    mask: NDArray[np.bool_] | None
    mean_reference: np.float32
    mean_current: np.float32

    def grey(self, rows: slice, columns: slice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Part of both images as float32 grey levels without the mean of the image, zero where masked."""
        f = np.subtract(self.reference[rows, columns], self.mean_reference, dtype=np.float32)
        if self.mask is not None:
            f[~self.mask[rows, columns]] = 0.0
        return f, np.subtract(self.current[rows, columns], self.mean_current, dtype=np.float32)

    def usable(self, rows: slice) -> NDArray[np.float32] | None:
        """1 where a pixel of these rows and its eight neighbours may be used, else 0; None without mask."""
        if self.mask is None:
            return None
        first = max(rows.start - 1, 0)
        return np.ascontiguousarray(usable_mask(self.mask[first : rows.stop + 1])[rows.start - first :][: rows.stop - rows.start])

    def used(self) -> float:
        """Fraction of the reference that is not masked."""
        if self.mask is None:
            return 1.0
        height = self.reference.shape[0]
        parts = (self.usable(slice(first, min(first + SLICE_ROWS, height))) for first in range(0, height, SLICE_ROWS))
        return sum(np.count_nonzero(part) for part in parts if part is not None) / self.reference.size

    def statistics(self) -> FrameStatistics:
        """Noise and gradient gains of the reference."""
        height, width = self.reference.shape
        rows, columns = (slice(s.start, min(s.stop, n)) for s, n in zip(central_region((height, width)), (height, width), strict=True))
        f, _ = self.grey(rows, columns)
        usable = self.usable(rows)
        part = None if usable is None else np.ascontiguousarray(usable[:, columns])
        return frame_statistics(np.ascontiguousarray(f), part, self.used())


def bands(grid: Grid, shape: tuple[int, ...], band_px: int, band_points: int) -> Iterator[tuple[int, int]]:
    """First and last (exclusive) row of points of each band."""
    overlap_px = 2 * HALO * grid.step_px + grid.subset_px + 2 * MARGIN_PX
    by_pixels = (band_px // shape[1] - overlap_px) // grid.step_px
    by_points = band_points // grid.nx - 2 * HALO
    rows = max(1, min(by_pixels, by_points))
    for first in range(0, grid.ny, rows):
        yield first, min(first + rows, grid.ny)


def initial_guesses(pair: _Pair, grid: Grid, search_px: float | None) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (n, 4) matches of blocks of the frame, and (ny, nx) where the pattern is periodic."""
    height, width = pair.reference.shape
    if max(height, width) <= MAX_UNDIVIDED_PX:
        f, g = pair.grey(slice(None), slice(None))
        coarse = prepare_coarse(f, grid, search_px)
        return match(coarse, g), coarse.ambiguous
    matches, ambiguous = [], np.zeros(grid.shape, dtype=bool)
    for j, rows in _cells(grid.y_px):
        for i, columns in _cells(grid.x_px):
            y0, x0 = (max(0, int(p[0]) - CELL_MARGIN_PX) for p in (grid.y_px[j:rows], grid.x_px[i:columns]))
            y1, x1 = (int(p[-1]) + CELL_MARGIN_PX for p in (grid.y_px[j:rows], grid.x_px[i:columns]))
            f, g = (np.ascontiguousarray(a) for a in pair.grey(slice(y0, min(y1, height)), slice(x0, min(x1, width))))
            cell = dataclasses.replace(
                grid,
                x0_px=int(grid.x_px[i]) - x0,
                y0_px=int(grid.y_px[j]) - y0,
                nx=columns - i,
                ny=rows - j,
            )
            coarse = prepare_coarse(f, cell, search_px)
            matches.append(match(coarse, g) + np.array([x0, y0, 0, 0]))
            ambiguous[j:rows, i:columns] = coarse.ambiguous
    return np.concatenate(matches), ambiguous


def _cells(positions: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
    """First and last (exclusive) index of the points of each cell along one axis."""
    edges = np.searchsorted(positions, np.arange(positions[0], positions[-1] + CELL_PX, CELL_PX))
    for first, last in itertools.pairwise(edges):
        if last > first:
            yield int(first), int(last)


def _local_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """Initial guesses from nearby matches, cell by cell."""
    seeds = np.zeros((*grid.shape, 6))
    in_rows = (matches[:, 1] >= grid.y_px[0] - FIELD_MARGIN_PX) & (matches[:, 1] <= grid.y_px[-1] + FIELD_MARGIN_PX)
    for first, last in _cells(grid.x_px):
        cell = dataclasses.replace(grid, x0_px=int(grid.x_px[first]), nx=last - first)
        near = in_rows & (matches[:, 0] >= cell.x_px[0] - FIELD_MARGIN_PX) & (matches[:, 0] <= cell.x_px[-1] + FIELD_MARGIN_PX)
        selected = matches[near] if near.any() else matches
        if len(selected):
            seeds[:, first:last] = smooth_field(selected, cell)
    return seeds


def _band(
    pair: _Pair,
    grid: Grid,
    guesses: tuple[NDArray[np.float64], NDArray[np.float64] | None],
    matches: NDArray[np.float64],
    ambiguous: NDArray[np.bool_],
    statistics: FrameStatistics,
    settings: DicSettings,
) -> PointMeasurements:
    """Correlate the rows of points of a band; if a subset reaches the side of the band, repeat with twice the margin."""
    height = pair.reference.shape[0]
    half = grid.subset_px // 2
    seeds, second = guesses
    margin = MARGIN_PX + int(np.abs(seeds[..., 3]).max(initial=0.0))
    while True:
        top = max(0, int(grid.y_px[0]) - half - margin)
        bottom = min(height, int(grid.y_px[-1]) + half + margin + 1)
        f, g = (np.ascontiguousarray(a) for a in pair.grey(slice(top, bottom), slice(None)))
        part_grid = dataclasses.replace(grid, y0_px=grid.y0_px - top)
        empty = np.empty((0, 0), dtype=np.float32)
        coarse = InitialGuessReference(1, empty, empty.astype(np.complex64), np.empty((0, 2), dtype=np.int64), ambiguous.copy())
        usable = pair.usable(slice(top, bottom))
        reference = prepare_part(f, usable, part_grid, settings, statistics, coarse)
        interpolator = images.interpolator(g, ORDER[settings.interpolation])
        solutions = solve(reference, interpolator, matches - np.array([0, top, 0, 0]), settings, seeds, lambda: second)
        if not _reaches_side(solutions, part_grid, top > 0, bottom < height, bottom - top):
            break
        margin *= 2
    return point_measurements(reference, solutions, settings)


def _reaches_side(solutions: interface.Solutions, grid: Grid, above: bool, below: bool, height: int) -> bool:
    """Whether a subset is near a side of the band within the frame, where the spline differs from that of the frame."""
    finished = np.isin(solutions.status, (PoiStatus.CONVERGED, PoiStatus.OUTSIDE_IMAGE))
    y = grid.y_px[:, None] + solutions.parameters[..., 3]
    min_distance = 0.8 * grid.subset_px + SPLINE_PX
    return bool((finished & ((above & (y < min_distance)) | (below & (y > height - 1 - min_distance)))).any())


def _empty(grid: Grid) -> PointMeasurements:
    """Empty measurements, to be filled band by band."""
    kinds = {
        "gradient": (np.float32, 4),
        "residual": (np.float32, 0),
        "contrast": (np.float32, 0),
        "status": (np.uint8, 0),
        "iterations": (np.int32, 0),
    }
    arrays = {}
    for field in dataclasses.fields(PointMeasurements):
        dtype, depth = kinds.get(field.name, (np.float64, 0))
        arrays[field.name] = np.zeros((*grid.shape, depth) if depth else grid.shape, dtype=dtype)
    return PointMeasurements(**arrays)
