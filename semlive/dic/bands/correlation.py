"""Correlation of frames of any size in bounded memory: bands of full width one after the other, then one outlier test of the map.

Rows of points do not depend on each other until failed points are retried from their neighbours. Therefore each row is correlated in one
band only, and then the columns with failed points are retried, with as many rows on each side as retries can reach. The result is
bit-identical to that of the complete frame. Only in frames with edges above MAX_UNDIVIDED_PX the initial guesses differ, because they are
computed cell by cell. Images and mask may be memory maps; only bands of them are read.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.bands import guesses
from semlive.dic.bands.global_tiles import measure_in_tiles
from semlive.dic.bands.guesses import initial_guesses, local_field
from semlive.dic.bands.image_pair import MARGIN_PX, Image, ImagePair, bands, image_pair, prepare_cut, reaches_side, rows_of
from semlive.dic.bands.retries import retry
from semlive.dic.bands.second_estimate import banded_second_estimates
from semlive.dic.correlate import MAX_PASSES, ORDER, first_attempts, point_measurements, refine_fourth_order, to_disparity_map
from semlive.dic.initial_guess.fields import residual_affine_field, smooth_field
from semlive.dic.method_choice import choose_map
from semlive.dic.neighbour_scatter import widened
from semlive.dic.outlier_rejection import PointMeasurements
from semlive.dic.reference import FrameStatistics
from semlive.dic.second_estimate import SecondEstimates
from semlive.errors import BadInput
from semlive.kernels import images
from semlive.kernels.subset_matching import interface

# Pixels of a band: 0.8 GB with gradients, coefficients and padded copies. Bands overlap by a subset and twice MARGIN_PX: of a frame of
# 16384 px 1.15 times its pixels are processed.
BAND_PX = 18_000_000
BAND_POINTS = 400_000  # points of a band: 0.3 GB with their matrices
HALO = MAX_PASSES + 1  # rows of points on each side of a band that retries can reach


SOLUTION = ("parameters", "zncc", "status", "iterations")  # arrays of solutions before any refinement


def is_large(shape: tuple[int, ...], grid: Grid) -> bool:
    """Whether a frame or grid is processed in bands, because processing it at once would need more than 1 GB."""
    return shape[0] * shape[1] > guesses.MAX_UNDIVIDED_PX**2 or grid.nx * grid.ny > BAND_POINTS


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
    """Disparity of two images of any size: the result of `correlate`, band by band; the global method measures tiles (`global_tiles`).

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
        BadInput: the images differ in size, grid and settings in the subset, or the mask has another size than the images.
    """
    if reference.shape != current.shape:
        (h0, w0), (h1, w1) = reference.shape, current.shape
        raise BadInput(f"the reference is {w0} x {h0} px but the current image {w1} x {h1} px: give two images of one size")
    if grid.subset_px != settings.subset_px:
        raise BadInput(f"the grid was made for subsets of {grid.subset_px} px, the settings have {settings.subset_px}: make a new grid")
    if mask is not None and mask.shape != reference.shape:
        (h0, w0), (h1, w1) = mask.shape, reference.shape
        raise BadInput(f"the mask is {w0} x {h0} px but the images {w1} x {h1} px: give a mask of their size")
    mask = None if mask is None or mask.all() else mask
    pair = image_pair(reference, current, mask)
    statistics = pair.statistics()
    to_map = partial(to_disparity_map, grid=grid, settings=settings, reference_frame=reference_frame, current_frame=current_frame)
    by_field = partial(measure_in_tiles, pair, grid, settings=settings, reference_frame=reference_frame, current_frame=current_frame)
    if settings.method == "global":
        return by_field(_unusable(pair, grid, settings))
    measured = _measurements(pair, grid, settings, statistics, band_px, band_points)

    disparity = to_map(measured)

    def second() -> SecondEstimates:
        # both filters of a band need as much memory again
        return banded_second_estimates(pair, grid, measured, statistics, settings, band_px // 2, band_points)

    return choose_map(
        disparity,
        measured,
        statistics.noise_grey,
        settings,
        lambda: to_map(measured, second=second()),
        lambda: by_field(measured.status),
        lambda: widened(disparity, second(), settings),
    )


def _unusable(pair: ImagePair, grid: Grid, settings: DicSettings) -> NDArray[np.uint8]:
    """(ny, nx) PoiStatus: MASKED where too few pixels of a subset may be used, else CONVERGED."""
    status = np.full(grid.shape, PoiStatus.CONVERGED, dtype=np.uint8)
    half = grid.subset_px // 2
    for j, y in enumerate(int(y) for y in grid.y_px):
        usable = pair.usable(slice(y - half, y + half + 1))
        if usable is None:
            break
        total = np.concatenate([[0.0], np.cumsum(usable.sum(axis=0, dtype=np.float64))])
        first = grid.x_px.astype(np.intp) - half
        pixels = total[first + grid.subset_px] - total[first]
        status[j, pixels < settings.min_valid_fraction * grid.subset_px**2] = PoiStatus.MASKED
    return status


def _measurements(
    pair: ImagePair, grid: Grid, settings: DicSettings, statistics: FrameStatistics, band_px: int, band_points: int
) -> PointMeasurements:
    """Measurements of all points by subsets."""
    shape = pair.reference.shape
    matches, ambiguous = initial_guesses(pair, grid, settings.search_px)
    undivided = max(shape) <= guesses.MAX_UNDIVIDED_PX and len(matches) > 0
    guess = smooth_field(matches, grid) if undivided else None
    second_field = residual_affine_field(matches, grid) if undivided else None
    merged, attempted = _empty(grid), _no_solutions(grid)
    for first, last in bands(grid, shape, band_px, band_points):
        rows = rows_of(grid, first, last)
        seeds = guess[first:last] if guess is not None else local_field(matches, rows)
        second = None if second_field is None else second_field[first:last]
        part, solutions = _band(pair, rows, (seeds, second), matches, ambiguous[first:last], statistics, settings)
        for field in dataclasses.fields(PointMeasurements):
            getattr(merged, field.name)[first:last] = getattr(part, field.name)
        for name in SOLUTION:
            getattr(attempted, name)[first:last] = getattr(solutions, name)
    for first, last in bands(grid, shape, band_px, band_points, HALO):
        low, high = max(first - HALO, 0), min(last + HALO, grid.ny)
        around = interface.Solutions(*(getattr(attempted, name)[low:high] for name in SOLUTION))
        retried = retry(pair, rows_of(grid, low, high), slice(first - low, last - low), around, statistics, settings)
        if retried is not None:
            j, i, part = retried
            for field in dataclasses.fields(PointMeasurements):
                getattr(merged, field.name)[low + j, i] = getattr(part, field.name)
    return merged


def _band(
    pair: ImagePair,
    grid: Grid,
    guesses: tuple[NDArray[np.float64], NDArray[np.float64] | None],
    matches: NDArray[np.float64],
    ambiguous: NDArray[np.bool_],
    statistics: FrameStatistics,
    settings: DicSettings,
) -> tuple[PointMeasurements, interface.Solutions]:
    """Attempt the rows of points of a band; if a subset reaches the side of the band, repeat with twice the margin.

    Returns:
        The measurements, and the solutions before any refinement.
    """
    height = pair.reference.shape[0]
    half = grid.subset_px // 2
    seeds, second = guesses
    margin = MARGIN_PX + int(np.abs(seeds[..., 3]).max(initial=0.0))
    while True:
        top = max(0, int(grid.y_px[0]) - half - margin)
        bottom = min(height, int(grid.y_px[-1]) + half + margin + 1)
        f, g = (np.ascontiguousarray(a) for a in pair.grey(slice(top, bottom), slice(None)))
        part_grid = dataclasses.replace(grid, y0_px=grid.y0_px - top)
        reference = prepare_cut(f, pair.usable(slice(top, bottom)), part_grid, settings, statistics, ambiguous)
        interpolator = images.interpolator(g, ORDER[settings.interpolation])
        solutions = first_attempts(reference, interpolator, matches - np.array([0, top, 0, 0]), settings, seeds, lambda: second)
        low, high = -np.inf if top == 0 else 0.0, np.inf if bottom == height else bottom - top - 1.0
        y = part_grid.y_px[:, None] + solutions.parameters[..., 3]
        if not reaches_side(solutions, y, grid.subset_px, np.array(low), np.array(high)):
            break
        margin *= 2
    refined = dataclasses.replace(solutions, **{name: getattr(solutions, name).copy() for name in SOLUTION})
    refine_fourth_order(reference, interpolator, refined, settings)
    return point_measurements(reference, refined, settings), solutions


def _no_solutions(grid: Grid) -> interface.Solutions:
    """Solutions of no attempt."""
    return interface.Solutions(
        np.zeros((*grid.shape, 6)), np.zeros(grid.shape), np.zeros(grid.shape, dtype=np.uint8), np.zeros(grid.shape, dtype=np.int32)
    )


def _empty(grid: Grid) -> PointMeasurements:
    """Empty measurements, to be filled band by band."""
    kinds = {
        "gradient": (np.float32, 4),
        "residual": (np.float32, 0),
        "contrast": (np.float32, 0),
        "length": (np.float32, 0),
        "status": (np.uint8, 0),
        "iterations": (np.int32, 0),
    }
    arrays = {}
    for field in dataclasses.fields(PointMeasurements):
        dtype, depth = kinds.get(field.name, (np.float64, 0))
        arrays[field.name] = np.zeros((*grid.shape, depth) if depth else grid.shape, dtype=dtype)
    return PointMeasurements(**arrays)
