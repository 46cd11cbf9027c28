"""Medians and percentiles, the same numbers as NumPy's to the last bit, without what its own cost for few values."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BINS = 2048  # of eleven bits
UPPER, MIDDLE = np.uint32(20), np.uint32(9)  # where those of the sign, the exponent and three more begin, and the next eleven


def median_of(values: NDArray[np.floating]) -> np.floating:
    """Median of (n,) values, none of them NaN, n >= 1, in their own precision."""
    low, high = (values.size - 1) // 2, values.size // 2
    ordered = np.partition(values, (low, high))
    return (ordered[low] + ordered[high]) / 2


def percentiles_of(values: NDArray[np.floating], *percents: float) -> list[float]:
    """Percentiles of (n,) values, none of them NaN, n >= 1, linear between neighbours."""
    places = [(values.size - 1) * (percent / 100) for percent in percents]
    ordered = np.partition(values, sorted({min(int(place) + k, values.size - 1) for place in places for k in (0, 1)}))
    found = []
    for place in places:
        first = int(place)
        part = place - first
        a, b = ordered[first], ordered[min(first + 1, values.size - 1)]
        step = float(b - a)
        found.append(float(b) - step * (1.0 - part) if part >= 0.5 else float(a) + step * part)
    return found


@njit(nogil=True, cache=True)
def ptp_columns(values):
    """Largest less least of each column of (n, m) values, n >= 1; NaN where there is one."""
    low, high = values[0].copy(), values[0].copy()
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            value = values[k, i]
            low[i] = value if value < low[i] or value != value else low[i]
            high[i] = value if value > high[i] or value != value else high[i]
    return high - low


@njit(nogil=True, cache=True)
def _bin_of(count, k):
    """Bin that holds rank k, and how many are in those before."""
    before = 0
    for b in range(count.size):
        if before + count[b] > k:
            return b, before
        before += count[b]
    return count.size - 1, before


@njit(nogil=True, cache=True)
def _narrowed(bits, n, k, shift):
    """Values of the first n in the bin of rank k, their number, the number of smaller values, and the smallest larger value."""
    count = np.zeros((2, BINS), dtype=np.int64)  # two alternating counters, because an increment waits for the previous one of its bin
    mask, most = np.uint32(BINS - 1), np.uint32(0xFFFFFFFF)
    for i in range(n):
        count[i & 1, (bits[i] >> shift) & mask] += 1
    rank_bin, before = _bin_of(count[0] + count[1], k)
    inside = count[0, rank_bin] + count[1, rank_bin]
    some = np.empty(n + 1, dtype=np.uint32)
    m = 0
    for i in range(n):  # without a branch, which could not be predicted
        some[m] = bits[i]
        m += np.int64((bits[i] >> shift) & mask == rank_bin)
    least = most
    if before + inside == k + 1:
        for i in range(n):
            least = min(least, bits[i] if (bits[i] >> shift) & mask > rank_bin else most)
    return some, inside, before, least


@njit(nogil=True, cache=True)
def middle_bits(bits, n):
    """Bits of the two middle values of the first n of positive float32 in `bits` (uint32), which order as the values do.

    Each value is read twice, in order; NumPy's partition of 33,000 takes four times as long.
    """
    low, high = (n - 1) // 2, n // 2
    some, m, before, beyond = _narrowed(bits, n, low, UPPER)
    few, m, less, next_of_some = _narrowed(some, m, low - before, MIDDLE)
    few = np.sort(few[:m])
    at = low - before - less
    if high == low or at + 1 < m:
        return few[at], few[at + high - low]
    return few[at], min(next_of_some, beyond)
