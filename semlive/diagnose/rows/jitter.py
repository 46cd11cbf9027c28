"""Row jitter: shifts common to all segments of a row. Segments rolled against each other have no common shift and serve as the null."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from semlive.diagnose.rows.series import DETREND_ROWS, RowSeries

Array = NDArray[np.float64]
PERMUTATIONS = 60
MIN_ROLL = 5  # rows: interpolation correlates the noise of neighbours
SIZES = 12
MAX_PERIOD_ROWS = 28  # longer periods are attenuated by detrending
KINDS = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
"""Jitter along x, along y, or equally along both."""
DETRENDED = DETREND_ROWS / (DETREND_ROWS - 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class CommonRowVariance:
    """Variance of the row means relative to that of segments of different rows.

    Attributes:
        ratio: (pairs, 2) mean square of the row means, in units of the null.
        freedom: (pairs, 2) degrees of freedom of the ratio.
        variance_px2: (pairs, 2) variance of a row mean by noise alone, px^2.
        white: (pairs, 2) the ratio from the median of the spectrum of the row means, which excludes waves.
        frames: (pairs,) number of frames whose jitter a pair contains: 1 plus the fraction passed by interpolation.
    """

    ratio: Array
    freedom: Array
    variance_px2: Array
    white: Array
    frames: Array

    @property
    def excess_px2(self) -> Array:
        """(pairs, 2) jitter variance of one frame, px^2."""
        return DETRENDED * (self.ratio - 1.0) * self.variance_px2 / self.frames[:, None]

    @property
    def sigma_px2(self) -> Array:
        """(pairs, 2) standard uncertainty of the jitter variance, px^2."""
        return np.sqrt(2.0 / self.freedom) * self.ratio * self.variance_px2 / self.frames[:, None]

    def square_px2(self, selected: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
        """(2,) square of the jitter along x and y, which noise may make negative, and its uncertainty, from some of the pairs."""
        which = np.ones(len(self.frames), dtype=np.bool_) if selected is None else selected
        spread = np.sqrt(2.0 / self.freedom) * self.variance_px2 / self.frames[:, None]
        weight = spread[which] ** -2.0
        total = weight.sum(axis=0)
        sigma2 = np.sqrt(np.sum((self.sigma_px2[which] * weight) ** 2, axis=0))
        return np.sum(self.excess_px2[which] * weight, axis=0) / total, sigma2 / total

    def jitter_px(self) -> tuple[Array, Array]:
        """(2,) standard deviation along x and y, and its uncertainty."""
        square, sigma2 = self.square_px2()
        sd = np.sqrt(np.clip(square, 0.0, None))
        return sd, np.where(sd > 0.0, np.minimum(sigma2 / (2.0 * np.where(sd > 0.0, sd, 1.0)), np.sqrt(sigma2)), np.sqrt(sigma2))

    def levels(self) -> Array:
        """(pairs, 2) the ratio that white jitter of one size in all frames has, waves left out."""
        weight = self.freedom / self.variance_px2
        square = np.sum(weight * (self.white - 1.0), axis=0) / np.sum(weight / self.variance_px2 * self.frames[:, None], axis=0)
        return 1.0 + np.clip(square, 0.0, None) * self.frames[:, None] / self.variance_px2

    def p_value(self) -> float:
        """Fraction of data without jitter with at least this variance along x or along y."""
        weight = self.freedom / self.variance_px2  # as jitter of one size shows in each
        z = np.sum(weight * (self.ratio - 1.0), axis=0) / np.sqrt(np.sum(weight**2 * 2.0 / self.freedom, axis=0))
        return float(min(1.0, 2.0 * ndtr(-np.max(z))))

    def log_factor(self, sizes_px: tuple[float, float]) -> float:
        """Log Bayes factor of jitter of one size in all frames."""
        each = []
        for along in KINDS:
            for size_px in np.geomspace(*sizes_px, SIZES):
                more = np.array(along) * size_px**2 * self.frames[:, None] / (self.variance_px2 * DETRENDED)
                each.append(float(np.sum(0.5 * self.freedom * (self.ratio * more / (1.0 + more) - np.log1p(more)))))
        return float(np.logaddexp.reduce(each) - np.log(len(each)))


def common_row_variance(series: Sequence[RowSeries], seed: int) -> CommonRowVariance:
    """Common row variance of all pairs.

    Args:
        series: row series of each pair, corrected for waves.
        seed: seed of the random rolls.
    """
    rng = np.random.default_rng((seed, 51))
    ratio, freedom, variance, white = (np.ones((len(series), 2)) for _ in range(4))
    for at, run_series in enumerate(series):
        for axis in (0, 1):
            shift, weight = run_series.shift_px[axis], run_series.weight[axis]
            ratio[at, axis], freedom[at, axis], variance[at, axis] = _pair_variance_ratio(shift, weight, rng)
            white[at, axis] = _white(shift, weight) / variance[at, axis]
    return CommonRowVariance(ratio, freedom, variance, white, np.array([1.0 + run_series.interpolation_gain for run_series in series]))


def _pair_variance_ratio(shift: Array, weight: Array, rng: np.random.Generator) -> tuple[float, float, float]:
    """Ratio, freedom and variance of one pair along one axis."""
    n, pieces = shift.shape
    own = _mean_square(shift, weight)
    total = weight.sum(axis=1)
    used = total > 0.0
    count = float(np.mean(total[used] ** 2 / np.sum(weight[used] ** 2, axis=1))) if used.any() else 1.0
    if count < 2.0:  # fewer segments have no common part
        return 1.0, 1.0, 1.0
    rows = np.arange(n)[:, None]
    samples = []
    for _ in range(PERMUTATIONS):
        by = rng.integers(MIN_ROLL, n - MIN_ROLL, pieces)
        at = (rows + by) % n
        samples.append(_mean_square(np.take_along_axis(shift, at, axis=0), np.take_along_axis(weight, at, axis=0)))
    rolled = float(np.mean(samples))
    if not rolled > 0.0:
        return 1.0, 1.0, 1.0
    # Jitter is part of each segment, so rolled segments still contain a fraction 1 / count of it.
    noise = max((rolled - own / count) / (1.0 - 1.0 / count), 1e-3 * rolled)
    return own / noise, 2.0 * (rolled / float(np.std(samples, ddof=1))) ** 2, noise


def _white(shift: Array, weight: Array) -> float:
    """Mean square of the row means from the median of their spectrum, which is robust against spectral lines."""
    total = weight.sum(axis=1)
    mean = np.sum(shift * weight, axis=1) / np.where(total > 0.0, total, 1.0)
    power = np.abs(np.fft.rfft(mean)) ** 2 / len(mean)
    return float(np.median(power[len(mean) // MAX_PERIOD_ROWS :])) / math.log(2.0)


def _mean_square(shift: Array, weight: Array) -> float:
    """Mean square of the weighted row means."""
    total = weight.sum(axis=1)
    used = total > 0.0
    mean = np.sum(shift * weight, axis=1)[used] / total[used]
    return float(np.mean(mean**2)) if used.any() else 0.0
