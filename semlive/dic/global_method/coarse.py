"""Initial displacement: shift of the frame, then blocks that two band-passes find at the same place.

The frame shift is the best of all with sufficient overlap, by ZNCC over the common area (three correlations by Fourier transform).
Each block is then searched around it in both band-passed images. A block counts if both agree and a neighbour without a common pixel
moved alike: in six real pairs 72 to 91 % of the blocks, in 600 pairs of noise (white, coarse or of one grey level, 150 to 256 px) at
most 22 %, and at most 12 % of white noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from semlive.dic.global_method.filters import band_pass

Image = NDArray[np.float32]
Array = NDArray[np.float64]

FINE, COARSE = (1.0, 6.0), (3.0, 12.0)  # px; the two band-passes of the blocks
MAX_EDGE_PX = 768  # larger frames are binned for this step
BLOCK_PX = 48  # binned px; contains several grains of a texture without speckle
SEARCH_PX = 16  # binned px
BLOCKS_ALONG = 32  # largest number of blocks along the longer edge
AGREEMENT_PX = 1.5  # binned px
MIN_OVERLAP = 0.25  # of the frame
MIN_AGREEING = 0.25  # of the blocks, confirmed by a neighbour; 0.72 at least in real pairs, 0.22 at most in 600 pairs of noise
MIN_BLOCKS = 6
LOBE_PX = 6  # half the extent of a peak of the correlation
MAX_SECOND_PEAK = 0.95  # of the best; above, the frame matches itself at two shifts


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Blocks found at the same place by both band-passes.

    Attributes:
        matches: (n, 4) x, y, u, v in px.
        fraction: fraction of all blocks of the common area that also have a neighbour that moved alike.
        ambiguous: whether another shift of the frame fits as well.
    """

    matches: Array
    fraction: float
    ambiguous: bool

    @property
    def sufficient(self) -> bool:
        """Whether the frames show the same place."""
        return len(self.matches) >= MIN_BLOCKS and self.fraction >= MIN_AGREEING


def find_blocks(f: Image, g: Image, search_px: float | None = None) -> Blocks:
    """Match blocks of two frames of the same size.

    Args:
        f: (height, width) reference, without row offsets.
        g: (height, width) current frame, without row offsets.
        search_px: largest possible motion along x or y; None: the frames overlap by a quarter at least.
    """
    binning = max(1, -(-max(f.shape) // MAX_EDGE_PX))
    f, g = (_binned(image, binning) for image in (f, g))
    fine, coarse = ((band_pass(f, band), band_pass(g, band)) for band in (FINE, COARSE))
    shift, ambiguous = _frame_shift(*fine, None if search_px is None else search_px / binning)
    step = max(BLOCK_PX // 4, -(-max(f.shape) // BLOCKS_ALONG))
    found = [_match(*pair, shift, step) for pair in (fine, coarse)]
    count = len(found[0])
    agree = np.all(np.abs(found[0][:, 2:] - found[1][:, 2:]) <= AGREEMENT_PX, axis=1) if count else np.empty(0, dtype=bool)
    blocks = 0.5 * (found[0] + found[1])
    matches = blocks[agree] * binning
    if binning > 1:
        matches[:, :2] += 0.5 * (binning - 1)
    return Blocks(matches, float(np.sum(_confirmed(blocks[agree]))) / count if count else 0.0, ambiguous)


def _confirmed(blocks: Array) -> NDArray[np.bool_]:
    """(n,) whether a block without a common pixel, but next to it, moved alike.

    The two band-passes of one block contain the same noise, so they agree by chance in up to 0.3 of the blocks of unrelated frames.
    """
    distance = np.max(np.abs(blocks[:, None, :2] - blocks[None, :, :2]), axis=-1)
    difference = np.max(np.abs(blocks[:, None, 2:] - blocks[None, :, 2:]), axis=-1)
    return np.any((distance >= BLOCK_PX) & (distance <= 2 * BLOCK_PX) & (difference <= AGREEMENT_PX), axis=1)


def _binned(image: Image, binning: int) -> Image:
    if binning == 1:
        return image
    height, width = (n // binning * binning for n in image.shape)
    small = cv2.resize(image[:height, :width], (width // binning, height // binning), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def _frame_shift(f: Image, g: Image, limit: float | None) -> tuple[tuple[int, int], bool]:
    """Shift (x, y) of the frame with the largest ZNCC over the common area, and whether a second one is as good."""
    height, width = f.shape
    size = [int(fft.next_fast_len(2 * n - 1, real=True) or 2 * n) for n in (height, width)]
    f1, g1, one, f2, g2 = (np.asarray(fft.rfft2(a, s=size)) for a in (f, g, np.ones_like(f), f * f, g * g))

    def correlation(a: NDArray, b: NDArray) -> Array:
        return np.asarray(fft.irfft2(np.conj(a) * b, s=size), dtype=np.float64)

    count = np.maximum(np.round(correlation(one, one)), 1.0)
    sum_f, sum_g = correlation(f1, one), correlation(one, g1)
    covariance = correlation(f1, g1) - sum_f * sum_g / count
    variances = [correlation(f2, one) - sum_f**2 / count, correlation(one, g2) - sum_g**2 / count]
    smallest = 1e-6 * float(np.sum(f * f) + np.sum(g * g))
    usable = (count >= MIN_OVERLAP * height * width) & (np.minimum(*variances) > smallest)
    if limit is not None:
        lags = [np.abs(fft.fftfreq(n, 1.0 / n)) for n in size]
        usable &= (lags[0][:, None] <= limit + 1.0) & (lags[1] <= limit + 1.0)
    score = np.full(size, -1.0)
    score[usable] = covariance[usable] / np.sqrt(variances[0][usable] * variances[1][usable])
    peaks: list[tuple[int, int, float]] = []
    for _ in range(2):
        y, x = divmod(int(np.argmax(score)), size[1])
        peaks.append((x - size[1] * (x > size[1] // 2), y - size[0] * (y > size[0] // 2), float(score[y, x])))
        rows, columns = ((np.arange(at - LOBE_PX, at + LOBE_PX + 1) % n) for at, n in ((y, size[0]), (x, size[1])))
        score[np.ix_(rows, columns)] = -1.0
    (x, y, best), (_, _, second) = peaks
    return (x, y), second > MAX_SECOND_PEAK * best


def _match(f: Image, g: Image, shift: tuple[int, int], step: int) -> Array:
    """(n, 4) x, y, u, v of all blocks in the common area; NaN for blocks that are not found within the search range."""
    (height, width), (sx, sy) = f.shape, shift
    out = []
    for y in range(max(0, -sy), min(height, height - sy) - BLOCK_PX + 1, step):
        for x in range(max(0, -sx), min(width, width - sx) - BLOCK_PX + 1, step):
            top, first_column = max(0, y + sy - SEARCH_PX), max(0, x + sx - SEARCH_PX)
            window = g[top : y + sy + BLOCK_PX + SEARCH_PX, first_column : x + sx + BLOCK_PX + SEARCH_PX]
            found = peak_of(window, f[y : y + BLOCK_PX, x : x + BLOCK_PX])
            u, v = (np.nan, np.nan) if found is None else (first_column + found[0] - x, top + found[1] - y)
            out.append((x + 0.5 * (BLOCK_PX - 1), y + 0.5 * (BLOCK_PX - 1), u, v))
    return np.array(out, dtype=np.float64).reshape(-1, 4)


def peak_of(window: Image, block: Image) -> tuple[float, float] | None:
    """Sub-pixel position (x, y) in the window of the first pixel of the best match; None at the edge of the range or without contrast."""
    if not np.ptp(block) > 0.0 or min(window.shape) < block.shape[0] + 2:
        return None
    score = np.asarray(cv2.matchTemplate(window, block, cv2.TM_CCOEFF_NORMED))
    y, x = divmod(int(np.argmax(score)), score.shape[1])
    if not (0 < x < score.shape[1] - 1 and 0 < y < score.shape[0] - 1):
        return None
    return x + _vertex(score[y, x - 1 : x + 2]), y + _vertex(score[y - 1 : y + 2, x])


def _vertex(values: NDArray) -> float:
    """Position of the maximum of a parabola through three values at -1, 0, 1."""
    before, here, after = (float(value) for value in values)
    curvature = before - 2.0 * here + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
