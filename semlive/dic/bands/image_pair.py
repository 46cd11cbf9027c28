"""Images of a pair that are read in bands or strips, and the sizes of these."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.initial_guess.search import InitialGuessReference
from semlive.dic.reference import FrameStatistics, Reference, central_region, frame_statistics, prepare_part, usable_mask
from semlive.kernels.subset_matching import interface

SLICE_ROWS = 1024  # rows that are read at once to evaluate a complete image
MARGIN_PX = 48  # around the subsets of a band or strip at their initial guesses
SPLINE_PX = 24  # distance at which the boundary changes spline coefficients by less than the float32 resolution

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class ImagePair:
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


def image_pair(reference: Image, current: Image, mask: NDArray[np.bool_] | None) -> ImagePair:
    """Pair of images of the same size, with the mean grey level of the unmasked part of the reference, as in `prepare`."""
    return ImagePair(reference, current, mask, _mean(reference, mask), _mean(current, None))


def _mean(image: Image, mask: NDArray[np.bool_] | None) -> np.float32:
    if mask is None:
        return np.float32(image.mean())
    total = count = 0
    for first in range(0, image.shape[0], SLICE_ROWS):
        rows = slice(first, first + SLICE_ROWS)
        total += int(image[rows].sum(dtype=np.int64, where=mask[rows]))
        count += int(np.count_nonzero(mask[rows]))
    return np.float32(total / count if count else 0.0)


def rows_of(grid: Grid, first: int, last: int) -> Grid:
    """Rows first..last-1 of the points of a grid."""
    return replace(grid, y0_px=grid.y0_px + first * grid.step_px, ny=last - first)


def bands(grid: Grid, shape: tuple[int, ...], band_px: int, band_points: int, halo: int = 0) -> Iterator[tuple[int, int]]:
    """First and last (exclusive) row of points of each band, with space for `halo` more rows of points on each side."""
    overlap_px = 2 * halo * grid.step_px + grid.subset_px + 2 * MARGIN_PX
    by_pixels = (band_px // shape[1] - overlap_px) // grid.step_px
    by_points = band_points // grid.nx - 2 * halo
    rows = max(1, min(by_pixels, by_points))
    for first in range(0, grid.ny, rows):
        yield first, min(first + rows, grid.ny)


def prepare_cut(
    f: NDArray[np.float32],
    usable: NDArray[np.float32] | None,
    grid: Grid,
    settings: DicSettings,
    statistics: FrameStatistics,
    ambiguous: NDArray[np.bool_],
) -> Reference:
    """Prepare a part of the reference whose initial guesses come from elsewhere; arguments as for `prepare_part`."""
    empty = np.empty((0, 0), dtype=np.float32)
    coarse = InitialGuessReference(1, empty, empty.astype(np.complex64), np.empty((0, 2), dtype=np.int64), ambiguous.copy())
    return prepare_part(f, usable, grid, settings, statistics, coarse)


def reaches_side(
    solutions: interface.Solutions, positions: NDArray[np.float64], subset_px: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> bool:
    """Whether a subset is near a side of its part within the frame, where the spline differs from that of the frame.

    Args:
        solutions: of the points.
        positions: (ny, nx) positions of the displaced points along one axis, px.
        subset_px: edge of a subset.
        low: first pixel of the part, -inf where this is the first of the frame; of a shape that fits to `positions`.
        high: last pixel of the part, inf where this is the last of the frame.
    """
    finished = np.isin(solutions.status, (PoiStatus.CONVERGED, PoiStatus.OUTSIDE_IMAGE))
    min_distance = 0.8 * subset_px + SPLINE_PX
    return bool((finished & ((positions - low < min_distance) | (high - positions < min_distance))).any())
