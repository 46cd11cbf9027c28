"""Virtual strain gauge: local first-order least squares over a square window of POI."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from semlive.data.strain import Displacement, StrainField
from semlive.errors import IllPosed
from semlive.kernels.window_moments import window_moments

MIN_FILL = 0.5  # of the window's POI; a window at the edge of the grid is cut to about half, at a corner to a quarter
MIN_POINTS = 4
MIN_SPREAD = 0.25  # smallest eigenvalue of the points' spread, relative to a full window's


def strain(displacement: Displacement, window_points: int) -> StrainField:
    """Engineering small strain from a plane fitted to u and v over `window_points` x `window_points` POI.

    Masked POI and POI beyond the edge are left out of the fit. A point is valid when it was measured itself and its
    window, as cut by the edge of the grid, is at least half full and not too thin in any direction.

    Args:
        displacement: on the grid of frame 0.
        window_points: odd, >= 3.

    Raises:
        IllPosed: the window is larger than the grid, even, or too small.
    """
    grid = displacement.grid
    if window_points < 3 or window_points % 2 == 0 or window_points > min(grid.nx, grid.ny):
        largest = min(grid.nx, grid.ny)
        raise IllPosed(
            f"a strain window of {window_points} points does not fit {grid.nx} x {grid.ny} points: take an odd number, 3 to {largest}"
        )
    half, weight = window_points // 2, displacement.valid.astype(np.float64)
    # Most frames have all points, and their windows are the same: half of the time.
    fit = _whole(grid.shape, window_points) if displacement.valid.all() else _fit(displacement.valid, window_points)
    valid = fit.valid.copy()
    scale = fit.determinant * grid.step_px
    ux, uy = _slopes(displacement.u_px * weight, half, fit.moments, scale)
    vx, vy = _slopes(displacement.v_px * weight, half, fit.moments, scale)
    exx, eyy, exy = (np.where(valid, value, 0.0) for value in (ux, vy, 0.5 * (uy + vx)))
    for component in (exx, eyy, exy, valid):
        component.setflags(write=False)
    return StrainField(displacement.frame, grid, window_points, exx, eyy, exy, valid)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Window statistics of a mask, independent of the displacement.

    Attributes:
        valid: (ny, nx) True where a window has enough points in every direction.
        determinant: (ny, nx) determinant of the point scatter; 1 where not valid.
        moments: (ny, nx) each: count, sums of x and y, scatter xx, xy, yy.
    """

    valid: NDArray[np.bool_]
    determinant: NDArray[np.float64]
    moments: tuple[NDArray[np.float64], ...]


def _fit(mask: NDArray[np.bool_], window_points: int) -> _Fit:
    half, weight = window_points // 2, mask.astype(np.float64)
    n, sx, sxx, sy, sxy, syy = window_moments(weight, half, 2)
    count = np.maximum(n, 1.0)
    cxx, cxy, cyy = sxx - sx * sx / count, sxy - sx * sy / count, syy - sy * sy / count
    determinant = cxx * cyy - cxy * cxy
    window = window_moments(np.ones_like(weight), half, 0)[0]
    full = window_points**2 * (window_points**2 - 1) / 12.0
    # The smaller eigenvalue is at least determinant / trace; an edge cuts it to about an eighth.
    thin = determinant <= MIN_SPREAD * 0.125 * full * (cxx + cyy)
    valid = mask & (n >= np.maximum(MIN_POINTS, MIN_FILL * window)) & ~thin
    return _Fit(valid, np.where(valid, determinant, 1.0), (count, sx, sy, cxx, cxy, cyy))


@lru_cache(maxsize=4)
def _whole(shape: tuple[int, int], window_points: int) -> _Fit:
    return _fit(np.ones(shape, dtype=np.bool_), window_points)


def _slopes(
    value: NDArray[np.float64], half: int, moments: tuple[NDArray[np.float64], ...], scale: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slopes along x and y of the plane through the window of each POI."""
    count, sx, sy, cxx, cxy, cyy = moments
    s, tx, ty = window_moments(value, half, 1)
    dx, dy = tx - sx * s / count, ty - sy * s / count
    return (cyy * dx - cxy * dy) / scale, (cxx * dy - cxy * dx) / scale
