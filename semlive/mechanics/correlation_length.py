"""Correlation of a DIC program's noise over neighbouring points, estimated from its maps.

A displacement is a weighted mean over a subset, so the noise of neighbouring points is correlated: over the edge of a square subset, over
a round or Gaussian window, or farther in maps that were smoothed afterwards. An estimate that believes such points independent finds
effects in noise. Maps within pairs contain drift, which is smooth, and noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid

Array = NDArray[np.float64]
ORDER = 4  # total order of the polynomial that drift within a pair follows
MAX_LAGS, FIELD_FRACTION = 24, 0.35  # lags of the variogram, and their largest distance relative to the field
MIN_POINTS, MAX_POINTS = 40, 300_000  # valid points of a map or pairs of points at a lag, and points of a map in the estimate
MIN_LAGS = 3
CLIP = 6.0  # robust standard deviations; points beyond are outliers
SHAPES = (0.0, 0.2, 0.45, 1.0)  # Gaussian share of the window: standard deviation relative to edge + standard deviation
LENGTHS = 72
MIN_SIGMA_PX = 5e-4  # a tenth of the noise of the best maps; below it the residual is not noise
COARSE = 41  # places per axis of the field for the expected effect of the removed polynomial
_SEPARATION = np.abs(np.subtract.outer(np.arange(COARSE), np.arange(COARSE)))
MIN_CORRELATION = 0.1  # between neighbouring points: below it they are independent


@dataclass(frozen=True, slots=True)
class NoiseCorrelation:
    """Correlation of the noise over the points of a map.

    Attributes:
        edge_px: edge of the square with the area of correlation, px: points in it are worth one; 0 for independent points.
        gaussian: share of a Gaussian in the window, from 0 (square) to 1 (Gaussian).
        window_px: correlation length of what points share, px; 0 for independent points.
        own_fraction: fraction of the variance that each point has for itself.
        sigma_px: standard deviations of u and v, px.
        maps: number of maps in the estimate.
    """

    edge_px: float
    gaussian: float
    window_px: float
    own_fraction: float
    sigma_px: tuple[float, float]
    maps: int

    @property
    def subset_px(self) -> int:
        """Nearest odd edge, px; 0 for independent points."""
        return 2 * round((self.edge_px - 1.0) / 2.0) + 1 if self.edge_px else 0


def window_correlation(distance_px: Array, edge_px: float, gaussian: float) -> Array:
    """(...) correlation along one axis of noise seen through a window.

    The window is a square convolved with a Gaussian. Its correlation is a triangle convolved with a Gaussian, scaled to a
    correlation area of ``edge_px``.
    """
    if gaussian >= 1.0:
        return np.asarray(np.exp(-np.pi * (distance_px / edge_px) ** 2))
    width, sd = 1.0 - gaussian, math.sqrt(2.0) * gaussian
    scale = float(_triangle(np.zeros(1), width, sd)[0])
    # A triangle of height 1 and half width w has the area w, which the Gaussian does not change.
    return np.asarray(_triangle(np.abs(distance_px) * (width / scale) / edge_px, width, sd) / scale)


def _triangle(distance: Array, width: float, sd: float) -> Array:
    """Triangle of unit height and the given half width, convolved with a Gaussian."""
    if sd == 0.0:
        return np.clip(1.0 - distance / width, 0.0, None)
    ramp = [_ramp(distance + offset, sd) for offset in (-width, 0.0, width)]
    return np.asarray((ramp[0] - 2.0 * ramp[1] + ramp[2]) / width)


def _ramp(x: Array, sd: float) -> Array:
    """Integral of the normal distribution function, the ramp max(x, 0) convolved with a Gaussian."""
    return np.asarray(0.5 * x * (1.0 + erf(x / (sd * math.sqrt(2.0)))) + sd * np.exp(-0.5 * (x / sd) ** 2) / math.sqrt(2.0 * np.pi))


def correlation_of(maps: Sequence[DisparityMap]) -> NoiseCorrelation | None:
    """Estimate the correlation from maps within pairs; None if no map has enough points.

    The variogram of each map, half the mean square difference of points at a distance, is compared with those of windows. Differences
    cancel what is smooth, and lost points leave the others as they are. Only distances along rows are used: drift differs from row to row.
    Maps without noise, as simulations write them, have no correlation.
    """
    variograms, sigmas = [], []
    for dmap in maps:
        u, v = (_rough(field, dmap.valid) for field in (dmap.u_px, dmap.v_px))
        if u is not None and v is not None:
            levels = float(np.nanvar(u)), float(np.nanvar(v))
            variograms += [_variogram(rough) / (level or 1.0) for rough, level in zip((u, v), levels, strict=True)]
            sigmas.append(np.sqrt(levels))
    if not variograms or np.median(sigmas) < MIN_SIGMA_PX:
        return None
    grid, values = maps[0].grid, np.array(variograms)
    defined = np.isfinite(values).any(axis=0)
    window_px, gaussian, own, sill = _fit(np.nanmedian(values[:, defined], axis=0), grid, _lags(grid.nx)[defined])
    sigma = math.sqrt(sill) * np.median(sigmas, axis=0)
    # With few lags within the window, its edge and the points' own noise compensate each other; the area of correlation is determined.
    edge_px = math.sqrt(own * grid.step_px**2 + (1.0 - own) * window_px**2) if window_px else 0.0
    return NoiseCorrelation(edge_px, gaussian, window_px, own, (float(sigma[0]), float(sigma[1])), len(sigmas))


def _rough(field: Array, valid: NDArray[np.bool_]) -> Array | None:
    """(ny, nx) the field minus a polynomial; NaN for lost points and outliers. None with too few points."""
    rows = slice(None, None, math.ceil(field.size / MAX_POINTS))  # distances along rows remain
    field, valid = field[rows], valid[rows]
    good = valid & np.isfinite(field)
    if good.sum() < MIN_POINTS:
        return None
    columns, residual = _polynomials(field.shape), field
    for _ in range(2):
        residual = field - columns @ np.linalg.lstsq(columns[good], field[good], rcond=None)[0]
        spread = 1.4826 * float(np.median(np.abs(residual[good])))
        good &= np.abs(residual) <= CLIP * spread
        if good.sum() < MIN_POINTS:
            return None
    return np.where(good, residual, np.nan)


def _polynomials(shape: tuple[int, ...]) -> Array:
    """(rows, columns, k) products of Legendre polynomials of total order up to `ORDER` over a field of points."""
    y, x = (np.linspace(-1.0, 1.0, count) for count in shape)
    order, products = np.arange(ORDER + 1), np.polynomial.legendre.legvander2d(*np.meshgrid(x, y), (ORDER, ORDER))
    return np.asarray(products[..., np.add.outer(order, order).ravel() <= ORDER], dtype=np.float64)


def _lags(count: int) -> NDArray[np.int64]:
    return np.unique(np.geomspace(1.0, max(FIELD_FRACTION * count, 2.0), MAX_LAGS).astype(np.int64))


def _variogram(rough: Array) -> Array:
    """(lags along x,) half the mean square difference; NaN with too few pairs of points."""
    values = []
    for lag in _lags(rough.shape[1]):
        squares = (rough[:, lag:] - rough[:, :-lag]) ** 2
        found = np.isfinite(squares)
        values.append(0.5 * float(squares[found].mean()) if found.sum() >= MIN_POINTS else np.nan)
    return np.array(values)


def _fit(variogram: Array, grid: Grid, lags: NDArray[np.int64]) -> tuple[float, float, float, float]:
    """Length in px and Gaussian share of the window, fraction of the variance without correlation, and sill that fit a variogram best."""
    distance_px, step_px = np.asarray(lags * grid.step_px, dtype=np.float64), float(grid.step_px)
    if len(variogram) < MIN_LAGS:
        return 0.0, 0.0, 1.0, 1.0
    weight, best = 1.0 / np.sqrt(distance_px), (np.inf, 0.0, 0.0, 1.0, 1.0)
    data = variogram * weight
    level = float(np.sum(data * weight) / np.sum(weight**2))
    for length_px, gaussian, shared in _window_variograms(grid, tuple(lags.tolist())):
        columns = np.stack((weight, shared * weight), axis=1)
        own, common = np.linalg.lstsq(columns, data, rcond=None)[0].tolist()
        if own < 0.0:
            own, common = 0.0, float(columns[:, 1] @ data / (columns[:, 1] @ columns[:, 1]))
        misfit = float(np.sum((columns @ (own, common) - data) ** 2))
        if common > 0.0 and misfit < best[0]:
            best = (misfit, length_px, gaussian, own / (own + common), own + common)
    misfit, length_px, gaussian, own, sill = best
    near = (1.0 - own) * float(window_correlation(np.array([step_px]), length_px, gaussian)[0]) if length_px else 0.0
    if misfit >= float(np.sum((level * weight - data) ** 2)) or near < MIN_CORRELATION:
        return 0.0, 0.0, 1.0, level
    return length_px, gaussian, own, sill


@lru_cache(maxsize=8)  # a verdict fits three times on one grid
def _window_variograms(grid: Grid, lags: tuple[int, ...]) -> tuple[tuple[float, float, Array], ...]:
    """Length in px, Gaussian share and expected (lags,) variogram of every candidate window."""
    distance_px, removed = np.array(lags, dtype=np.float64) * grid.step_px, _RemovedPolynomial(grid)
    lengths_px = np.geomspace(grid.step_px, max(float(distance_px.max()), 2.0 * grid.step_px), LENGTHS).tolist()
    return tuple(
        (length_px, gaussian, removed.variogram(distance_px, length_px, gaussian)) for gaussian in SHAPES for length_px in lengths_px
    )


class _RemovedPolynomial:
    """Expected variogram along rows of noise from which `_rough` removed a polynomial.

    The polynomial follows the noise of few windows in a field. Without this, a window of 99 px in a field of 560 px is estimated as 86 px.
    """

    def __init__(self, grid: Grid) -> None:
        shapes = np.linalg.qr(_polynomials((COARSE, COARSE)).reshape(COARSE**2, -1))[0]
        self._shapes = np.ascontiguousarray(shapes.T).reshape(-1, COARSE, COARSE)
        self._lags = np.arange(1, round(FIELD_FRACTION * COARSE) + 1)
        self._x_px, self._y_px = (np.linspace(0.0, (count - 1.0) * grid.step_px, COARSE) for count in (grid.nx, grid.ny))

    def variogram(self, distance_px: Array, length_px: float, gaussian: float) -> Array:
        """(lags,) half the expected square difference, relative to the variance of the noise, at distances along rows."""
        along_x, along_y = (window_correlation(position_px, length_px, gaussian)[_SEPARATION] for position_px in (self._x_px, self._y_px))
        shapes = self._shapes  # (k, y, x)
        shared = along_y @ shapes @ along_x
        amplitudes = np.tensordot(shapes, shared, ((1, 2), (1, 2)))
        half = shared - 0.5 * np.tensordot(amplitudes, shapes, (0, 0))
        # One product of all pairs of places in a row serves every lag: a tenth of the time of the differences over each.
        products = shapes.reshape(-1, COARSE).T @ half.reshape(-1, COARSE)
        removed = _squared_differences(products)[self._lags] / (COARSE * (COARSE - self._lags))
        at_px = self._x_px[np.append(0, self._lags)]
        return 1.0 - window_correlation(distance_px, length_px, gaussian) - np.interp(distance_px, at_px, np.append(0.0, removed))


def _squared_differences(products: Array) -> Array:
    """(lags,) sum of the products of differences over each lag, from the products (x, x) of two fields at all pairs of places."""
    up_to = np.cumsum(np.append(0.0, np.diagonal(products)))
    return np.asarray(up_to[-1] - up_to[:-1] + up_to[:0:-1] - np.bincount(_SEPARATION.ravel(), products.ravel()))
