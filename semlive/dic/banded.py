"""Correlation of frames of any size in bounded memory: full-width bands one after the other, then one outlier test over the whole map.

A band is correlated with additional rows of points on each side, as many as retries can reach, so the result is bit-identical to that of
the whole frame. Only frames larger than WHOLE_PX differ: their initial guesses are computed cell by cell. Images and mask may be
memory maps; only bands of them are read.
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
from semlive.dic.initial_guess import InitialGuessReference, match, prepare_coarse, residual_affine_field, smooth_field
from semlive.dic.outlier_rejection import PointMeasurements
from semlive.dic.reference import FrameStatistics, central_region, frame_statistics, prepare_part, usable_mask
from semlive.errors import BadInput
from semlive.kernels import interface

# Pixels of a band: 0.8 GB with gradients, coefficients and padded copies. Bands overlap by 347 px at a step of 8 px, 555 at 16: with
# 12e6 px, frames of 16384 px were worked on 1.9 and 4.2 times over, now 1.5 and 2.1 times.
BAND_PX = 18_000_000
BAND_POINTS = 400_000  # points of a band: 0.3 GB with their matrices
WHOLE_PX = 4096  # frames up to this edge get their first guesses as a whole, larger ones cell by cell
CELL_PX = 2048
CELL_MARGIN_PX = 192
FIELD_MARGIN_PX = 300  # four times the width that first guesses are smoothed over
ROOM_PX = 48  # around the subsets of a band, beyond where its first guesses lead
SPLINE_PX = 24  # a spline's coefficients forget its boundary within float32
SLICE_ROWS = 1024  # read at a time where a whole image has to be looked through
HALO = MAX_PASSES + 1

Image = NDArray[np.uint8] | NDArray[np.uint16]


def is_large(shape: tuple[int, ...], grid: Grid) -> bool:
    """Whether a frame or grid is processed in bands, because processing it at once would need more than 1 GB."""
    return shape[0] * shape[1] > WHOLE_PX**2 or grid.nx * grid.ny > BAND_POINTS


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
    """Disparity of two images of any size: what `correlate` finds, band by band.

    Args:
        reference: (height, width) uint8 or uint16, an array or a memory map.
        current: of the same size.
        grid: the points, from `grid_for`.
        settings: as for `prepare`.
        mask: (height, width) True where the reference may be used; None uses all of it.
        reference_frame: number of the reference frame.
        current_frame: number of the current frame.
        band_px: pixels of a band.
        band_points: points of a band.

    Raises:
        BadInput: the images differ in size, grid and settings about the subset, or the mask has another size than the images.
    """
    if reference.shape != current.shape:
        (h0, w0), (h1, w1) = reference.shape, current.shape
        raise BadInput(f"the reference is {w0} x {h0} px but the current image {w1} x {h1} px: give two images of one size")
    if grid.subset_px != settings.subset_px:
        raise BadInput(f"the grid was made for subsets of {grid.subset_px} px, the settings say {settings.subset_px}: make a new grid")
    if mask is not None and mask.shape != reference.shape:
        (h0, w0), (h1, w1) = mask.shape, reference.shape
        raise BadInput(f"the mask is {w0} x {h0} px but the images {w1} x {h1} px: give a mask of their size")
    mask = None if mask is None or mask.all() else mask
    pair = _Pair(reference, current, mask, _mean(reference, mask), _mean(current, None))
    traits = pair.traits()
    matches, ambiguous = first_guesses(pair, grid, settings.search_px)
    small = max(reference.shape) <= WHOLE_PX and len(matches) > 0
    guess = smooth_field(matches, grid) if small else None
    second_field = residual_affine_field(matches, grid) if small else None
    merged = _empty(grid)
    for first, last in bands(grid, reference.shape, band_px, band_points):
        low, high = max(first - HALO, 0), min(last + HALO, grid.ny)
        rows = dataclasses.replace(grid, y0_px=grid.y0_px + low * grid.step_px, ny=high - low)
        seeds = guess[low:high] if guess is not None else _local_field(matches, rows)
        second = None if second_field is None else second_field[low:high]
        part = _band(pair, rows, (seeds, second), matches, ambiguous[low:high], traits, settings)
        for field in dataclasses.fields(PointMeasurements):
            getattr(merged, field.name)[first:last] = getattr(part, field.name)[first - low : last - low]
    return to_disparity_map(merged, grid, settings, reference_frame=reference_frame, current_frame=current_frame)


def _mean(image: Image, mask: NDArray[np.bool_] | None) -> np.float32:
    """Of the part of an image that may be used, as `prepare` has it."""
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
    """Two images, which part of the first may be used (None: all of it), and their means."""

    reference: Image
    current: Image
    mask: NDArray[np.bool_] | None
    mean_reference: np.float32
    mean_current: np.float32

    def grey(self, rows: slice, columns: slice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """A part of both as float32 grey levels, the whole images' means subtracted, zero where masked."""
        f = np.subtract(self.reference[rows, columns], self.mean_reference, dtype=np.float32)
        if self.mask is not None:
            f[~self.mask[rows, columns]] = 0.0
        return f, np.subtract(self.current[rows, columns], self.mean_current, dtype=np.float32)

    def usable(self, rows: slice) -> NDArray[np.float32] | None:
        """1 where a pixel of these rows and the eight around it may be used, else 0; None for all."""
        if self.mask is None:
            return None
        first = max(rows.start - 1, 0)
        return np.ascontiguousarray(usable_mask(self.mask[first : rows.stop + 1])[rows.start - first :][: rows.stop - rows.start])

    def used(self) -> float:
        """The part of the reference that is not masked."""
        if self.mask is None:
            return 1.0
        height = self.reference.shape[0]
        parts = (self.usable(slice(first, min(first + SLICE_ROWS, height))) for first in range(0, height, SLICE_ROWS))
        return sum(np.count_nonzero(part) for part in parts if part is not None) / self.reference.size

    def traits(self) -> FrameStatistics:
        """Those of the reference."""
        height, width = self.reference.shape
        rows, columns = (slice(s.start, min(s.stop, n)) for s, n in zip(central_region((height, width)), (height, width), strict=True))
        f, _ = self.grey(rows, columns)
        usable = self.usable(rows)
        part = None if usable is None else np.ascontiguousarray(usable[:, columns])
        return frame_statistics(np.ascontiguousarray(f), part, self.used())


def bands(grid: Grid, shape: tuple[int, ...], band_px: int, band_points: int) -> Iterator[tuple[int, int]]:
    """First and last (exclusive) row of points of each band."""
    around = 2 * HALO * grid.step_px + grid.subset_px + 2 * ROOM_PX
    by_pixels = (band_px // shape[1] - around) // grid.step_px
    by_points = band_points // grid.nx - 2 * HALO
    rows = max(1, min(by_pixels, by_points))
    for first in range(0, grid.ny, rows):
        yield first, min(first + rows, grid.ny)


def first_guesses(pair: _Pair, grid: Grid, search_px: float | None) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(n, 4) matches of blocks all over the frame, and (ny, nx) where the pattern repeats itself."""
    height, width = pair.reference.shape
    if max(height, width) <= WHOLE_PX:
        f, g = pair.grey(slice(None), slice(None))
        coarse = prepare_coarse(f, grid, search_px)
        return match(coarse, g), coarse.ambiguous
    found, ambiguous = [], np.zeros(grid.shape, dtype=bool)
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
            found.append(match(coarse, g) + np.array([x0, y0, 0, 0]))
            ambiguous[j:rows, i:columns] = coarse.ambiguous
    return np.concatenate(found), ambiguous


def _cells(positions: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
    """First and last (exclusive) index of the points of each cell along one axis."""
    edges = np.searchsorted(positions, np.arange(positions[0], positions[-1] + CELL_PX, CELL_PX))
    for first, last in itertools.pairwise(edges):
        if last > first:
            yield int(first), int(last)


def _local_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """First guesses from the matches nearby, cell by cell."""
    seeds = np.zeros((*grid.shape, 6))
    tall = (matches[:, 1] >= grid.y_px[0] - FIELD_MARGIN_PX) & (matches[:, 1] <= grid.y_px[-1] + FIELD_MARGIN_PX)
    for first, last in _cells(grid.x_px):
        cell = dataclasses.replace(grid, x0_px=int(grid.x_px[first]), nx=last - first)
        near = tall & (matches[:, 0] >= cell.x_px[0] - FIELD_MARGIN_PX) & (matches[:, 0] <= cell.x_px[-1] + FIELD_MARGIN_PX)
        chosen = matches[near] if near.any() else matches
        if len(chosen):
            seeds[:, first:last] = smooth_field(chosen, cell)
    return seeds


def _band(
    pair: _Pair,
    grid: Grid,
    guesses: tuple[NDArray[np.float64], NDArray[np.float64] | None],
    matches: NDArray[np.float64],
    ambiguous: NDArray[np.bool_],
    traits: FrameStatistics,
    settings: DicSettings,
) -> PointMeasurements:
    """Correlate the rows of points of a band; if a subset comes near the band's side, once more with twice the room."""
    height = pair.reference.shape[0]
    half = grid.subset_px // 2
    seeds, second = guesses
    room = ROOM_PX + int(np.abs(seeds[..., 3]).max(initial=0.0))
    while True:
        top = max(0, int(grid.y_px[0]) - half - room)
        bottom = min(height, int(grid.y_px[-1]) + half + room + 1)
        f, g = (np.ascontiguousarray(a) for a in pair.grey(slice(top, bottom), slice(None)))
        here = dataclasses.replace(grid, y0_px=grid.y0_px - top)
        none = np.empty((0, 0), dtype=np.float32)
        coarse = InitialGuessReference(1, none, none.astype(np.complex64), np.empty((0, 2), dtype=np.int64), ambiguous.copy())
        usable = pair.usable(slice(top, bottom))
        reference = prepare_part(f, usable, here, settings, traits, coarse)
        interpolator = interface.interpolator(g, ORDER[settings.interpolation])
        solutions = solve(reference, interpolator, matches - np.array([0, top, 0, 0]), settings, seeds, lambda: second)
        if not _cramped(solutions, here, top > 0, bottom < height, bottom - top):
            break
        room *= 2
    return point_measurements(reference, solutions, settings)


def _cramped(solutions: interface.Solutions, grid: Grid, above: bool, below: bool, height: int) -> bool:
    """Whether a subset came near a side of the band that is not the frame's: the spline is not the frame's there."""
    finished = np.isin(solutions.status, (PoiStatus.CONVERGED, PoiStatus.OUTSIDE_IMAGE))
    y = grid.y_px[:, None] + solutions.parameters[..., 3]
    reach = 0.8 * grid.subset_px + SPLINE_PX
    return bool((finished & ((above & (y < reach)) | (below & (y > height - 1 - reach)))).any())


def _empty(grid: Grid) -> PointMeasurements:
    """A map to be filled band by band."""
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
