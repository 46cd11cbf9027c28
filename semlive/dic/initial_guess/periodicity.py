"""Periodic patterns, in which the correlation cannot distinguish motions that differ by a period.

The autocorrelation of the frame (one transform) shows the lags at which any part repeats. Only at these lags each subset is compared
with its surroundings. Ordinary speckle has no such lags: 20,000 blobs have an autocorrelation of at most 0.03.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from semlive.data.grid import Grid
from semlive.dic.initial_guess.fft_windows import low_pass

SEARCH_PX = 64.0  # assumed largest motion if it is unknown; two positions within it are at most twice as far apart
MIN_PEAK = 0.05  # autocorrelation of a frame of which a twentieth repeats
PEAK_SIGMAS = 5.0  # standard deviations of the autocorrelation of independent blobs
WINDOWED = 0.26  # effective fraction of the area of a frame with a Hann window along both axes
MAX_LAGS = 24  # strongest lags; a lattice has multiples of each period
MIN_LAG = 3  # binned pixels; shorter lags lie within one speckle
MIN_EDGE = 16  # binned pixels; smallest evaluated lag range, wider than a blob
MIN_SELF_ZNCC = 0.6  # ZNCC of a repeated subset; noise of 20 grey levels reduces it to 0.9, a sub-pixel position to 0.8
HIGH_PASS = 0.02  # cycles per binned pixel; removes shading, which correlates everywhere
AROUND_Y, AROUND_X = (k.ravel() - 1 for k in np.indices((3, 3)))  # a position and its eight neighbours


def periodic_lags(spectrum: NDArray[np.complex64], shape: tuple[int, int], reach: int) -> list[tuple[int, int]]:
    """Lags (x, y) in binned pixels at which the frame repeats, strongest first, one of each opposite pair.

    Args:
        spectrum: half spectrum of the windowed frame.
        shape: shape of the padded frame of the spectrum.
        reach: longest lag of interest.
    """
    height, width = shape
    shading = low_pass(width, HIGH_PASS, half=True) * low_pass(height, HIGH_PASS)[:, None]
    power = (spectrum.real**2 + spectrum.imag**2) * (1.0 - shading)
    surface = np.asarray(fft.irfft2(power, s=shape))
    if not surface[0, 0] > 0.0:
        return []
    edge = min(max(reach, MIN_EDGE) + 1, height // 2 - 1, width // 2 - 1)  # one more, to reject the flank of a peak beyond
    near = np.concatenate([surface[: edge + 1, width - edge :], surface[: edge + 1, : edge + 1]], axis=1) / surface[0, 0]
    blob = 2.27 * _half_width(near[0, edge:]) * _half_width(near[:, edge])  # sum of squares of a Gaussian main lobe
    chance = np.sqrt(blob / (WINDOWED * height * width))
    y, x = np.nonzero(near >= max(MIN_PEAK, PEAK_SIGMAS * chance))
    x -= edge
    searched = (x**2 + y**2 >= MIN_LAG**2) & ((y > 0) | (x > 0)) & (np.maximum(np.abs(x), y) <= reach)
    x, y = x[searched], y[searched]
    if not x.size:
        return []
    rows = np.clip(y[:, None] + AROUND_Y, 0, edge)
    columns = np.clip(x[:, None] + edge + AROUND_X, 0, 2 * edge)
    height_of = near[y, x + edge]
    top = height_of == near[rows, columns].max(axis=1)
    x, y = x[top], y[top]
    order = np.argsort(-height_of[top], kind="stable")[:MAX_LAGS]
    return [(int(x[k]), int(y[k])) for k in order]


def _half_width(line: NDArray[np.float32]) -> float:
    """Lag at which an autocorrelation falls to one half."""
    low = np.flatnonzero(line < 0.5)
    if not low.size:
        return float(line.size)
    k = int(low[0])
    return k - float((0.5 - line[k]) / (line[k - 1] - line[k]))


def ambiguous(
    image: NDArray[np.float32],
    spectrum: NDArray[np.complex64],
    padded: tuple[int, int],
    grid: Grid,
    binning: int,
    search_px: float | None = None,
) -> NDArray[np.bool_]:
    """Return (ny, nx) True where the reference subset repeats within the search range.

    Args:
        image: (h, w) binned reference.
        spectrum: half spectrum of the reference.
        padded: shape of the padded frame of the spectrum.
        grid: points of the full frame.
        binning: pixels per binned pixel.
        search_px: largest possible motion along x or y; None: SEARCH_PX.
    """
    height, width = image.shape
    reach = int(2 * (SEARCH_PX if search_px is None else search_px) / binning)
    repeating = np.zeros(image.shape, dtype=bool)
    window = max(5, grid.subset_px // binning) | 1
    for x, y in periodic_lags(spectrum, padded, reach):
        if abs(x) >= width or y >= height:
            continue
        here = np.s_[: height - y, max(-x, 0) : width - max(x, 0)]
        there = np.s_[y:, max(x, 0) : width - max(-x, 0)]
        repeated = _window_zncc(image[here], image[there], window) >= MIN_SELF_ZNCC
        repeating[here] |= repeated
        repeating[there] |= repeated
    rows = np.clip(np.round(grid.y_px / binning).astype(np.intp), 0, height - 1)
    columns = np.clip(np.round(grid.x_px / binning).astype(np.intp), 0, width - 1)
    return repeating[np.ix_(rows, columns)]


def _window_zncc(a: NDArray[np.float32], b: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """ZNCC of windows of two images at every pixel."""

    def mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.boxFilter(np.ascontiguousarray(values), -1, (window, window), borderType=cv2.BORDER_REFLECT_101), np.float32)

    ma, mb = mean(a), mean(b)
    va, vb = np.maximum(mean(a * a) - ma * ma, 0), np.maximum(mean(b * b) - mb * mb, 0)
    return np.asarray((mean(a * b) - ma * mb) / np.sqrt(va * vb + np.float32(1e-6)), dtype=np.float32)
