"""Initial guesses for IC-GN: one shift of the whole frame, then block matching around it, then a smooth field through the matches.

The frame shift is the peak of a low-passed phase correlation at half resolution. It is correct to a few px for shifts up to half the
frame, because strain, distortion and drift within a frame only broaden the peak. Blocks of 64 px are then searched within 32 px of it
by ZNCC, whose value decides whether a block is accepted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.spatial import KDTree

from semlive.data.grid import Grid
from semlive.dic.fft_windows import hann, low_pass
from semlive.dic.periodicity import ambiguous
from semlive.kernels.order_statistics import median_of
from semlive.kernels.threads import parallel_chunks

BLOCK = 32  # edge of a block, in binned pixels
SEARCH = 16  # search radius around the frame's shift, in binned pixels
BLOCK_DISTANCE_PX = 100  # roughly one block per this distance; distortion fields are smoother
MIN_BLOCK_ZNCC = 0.5  # the best of 33 x 33 unrelated positions stays below 0.35 for 7 px speckle
SETTLED_PX = 1e-3  # to which the affine fit is worked out, a first guess
OUTLIER_PX = 4.0  # distortion leaves 2 px about the affine fit
LOW_PASS = 0.15  # of the phase correlation, cycles per binned pixel: noise above, speckle below
CANDIDATES = 3
BLOCKS_AT_ONCE = 8  # that a thread takes
FIELD_CELL_PX = 640  # of points whose first guesses are smoothed from the same matches
FIELD_WIDTHS = 6.0  # away, a match weighs 1e-8: leaving it out makes the cost per point independent of the frame
MIN_INLIERS = 6  # blocks that agree on an affine map of six unknowns
ROTATION_CANDIDATES = (-9.0, -6.0, -3.0, 3.0, 6.0, 9.0)  # degrees


@dataclass(frozen=True, slots=True, eq=False)
class InitialGuessReference:
    """The reference frame as first guesses need it.

    Attributes:
        binning: pixels per binned pixel, 2, or 1 for small frames.
        image: (h, w) binned float32 grey levels.
        spectrum: spectrum of the windowed, padded image.
        centres: (n, 2) block centres (x, y) in binned pixels, those with contrast and at no repeating place.
        ambiguous: (ny, nx) points whose subsets repeat within the search range.
        search: longest motion along x or y in binned pixels; None if it is not known.
    """

    binning: int
    image: NDArray[np.float32]
    spectrum: NDArray[np.complex64]
    centres: NDArray[np.int64]
    ambiguous: NDArray[np.bool_]
    search: int | None = None


def prepare_coarse(image: NDArray[np.float32], grid: Grid, search_px: float | None = None) -> InitialGuessReference:
    """Bin the reference, transform it and lay out blocks over the grid; `search_px` as in `DicSettings`."""
    binning = 2 if min(image.shape) >= 4 * (BLOCK + SEARCH) else 1
    binned = _bin(image, binning)
    height, width = binned.shape
    x = _lattice(grid.x0_px, grid.x0_px + (grid.nx - 1) * grid.step_px, binning, width)
    y = _lattice(grid.y0_px, grid.y0_px + (grid.ny - 1) * grid.step_px, binning, height)
    spectrum = _spectrum(binned)
    repeating = ambiguous(binned, spectrum, _padded(binned.shape), grid, binning, search_px)

    i = np.clip(np.round((x * binning - grid.x0_px) / grid.step_px).astype(np.intp), 0, grid.nx - 1)
    j = np.clip(np.round((y * binning - grid.y0_px) / grid.step_px).astype(np.intp), 0, grid.ny - 1)
    unique = ~repeating[np.ix_(j, i)]
    centres = [(cx, cy) for k, cy in enumerate(y) for cx in x[unique[k]] if np.ptp(_block(binned, cx, cy)) > 0]
    return InitialGuessReference(
        binning=binning,
        image=binned,
        spectrum=spectrum,
        centres=np.array(centres, dtype=np.int64).reshape(-1, 2),
        ambiguous=repeating,
        search=None if search_px is None else int(np.ceil(search_px / binning)) + 1,
    )


def match(reference: InitialGuessReference, image: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n, 4) x, y, u, v in px of the blocks of the reference that were found in the current frame; n is 0 if none was.

    Args:
        reference: from `prepare_coarse`.
        image: (height, width) current frame, float32 grey levels.
    """
    current = _bin(image, reference.binning)
    limit = reference.search
    if limit is not None and limit <= SEARCH:
        return match_blocks(reference.image, reference.centres, current, (0, 0), limit) * reference.binning
    enough = max(1, len(reference.centres) // 2)
    best = np.empty((0, 4))
    for shift, _ in candidate_shifts(reference.spectrum, current):
        if limit is not None and max(abs(shift[0]), abs(shift[1])) > limit:
            continue
        matches = match_blocks(reference.image, reference.centres, current, shift)
        if len(matches) > len(best):
            best = matches
        if len(best) >= enough:
            break
    if len(best) < enough:
        best = search(reference, current, best)
    return best * reference.binning


def search(reference: InitialGuessReference, current: NDArray[np.float32], matches: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4) x, y, u, v in binned pixels where one shift of the frame did not find half of the blocks.

    Blocks that agree on an affine map lead to the others; if too few do, the frame may have turned, and is tried at angles up
    to 9 degrees, 3 apart (a block still correlates at half of that).

    Args:
        reference: from `prepare_coarse`.
        current: binned current frame.
        matches: those found so far.
    """
    few = max(MIN_INLIERS, len(reference.centres) // 8)
    matches = _grown(reference, current, matches)
    best = _led(reference, current, matches)
    if len(best) >= few:
        return best
    height, width = reference.image.shape
    tries = []
    for degrees in ROTATION_CANDIDATES:
        turn = cv2.getRotationMatrix2D((width / 2.0, height / 2.0), degrees, 1.0)
        turned = np.asarray(cv2.warpAffine(reference.image, turn, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)
        shift, height_of_peak = next(candidate_shifts(_spectrum(turned), current))
        tries.append((height_of_peak, degrees, turn + np.array([[0, 0, shift[0]], [0, 0, shift[1]]])))
    for _, _, affine in sorted(tries, key=lambda t: (-t[0], t[1]))[:2]:
        found = _led(reference, current, warped_blocks(reference, current, affine))
        if len(found) > len(best):
            best = found
    return best if len(best) else matches


def _grown(reference: InitialGuessReference, current: NDArray[np.float32], matches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matches and those found around the motion of the match nearest to each block, until no more are."""
    while 0 < len(matches) < len(reference.centres):
        unmatched = np.array([centre for centre in reference.centres if not (centre == matches[:, :2]).all(axis=1).any()])
        _, nearest = KDTree(matches[:, :2]).query(unmatched)
        fresh = match_blocks(reference.image, unmatched, current, np.round(matches[nearest, 2:]).astype(np.int64))
        if not len(fresh):
            break
        matches = np.concatenate([matches, fresh])
    return matches


def _led(reference: InitialGuessReference, current: NDArray[np.float32], matches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matches found again around the affine map on which the given ones agree; empty without agreement."""
    few = max(MIN_INLIERS, len(reference.centres) // 8)
    best = np.empty((0, 4))
    for _ in range(2):
        if len(matches) < MIN_INLIERS:
            break
        coefficients, good = _robust_affine(matches[:, 0], matches[:, 1], matches[:, 2:])
        if good.sum() < max(MIN_INLIERS, len(matches) // 2):
            break
        if len(matches) > len(best):
            best = matches
        c = coefficients
        affine = np.array([[1.0 + c[1, 0], c[2, 0], c[0, 0]], [c[1, 1], 1.0 + c[2, 1], c[0, 1]]])
        matches = warped_blocks(reference, current, affine)
    return best if len(matches) <= len(best) or len(matches) < few else matches


def warped_blocks(reference: InitialGuessReference, current: NDArray[np.float32], affine: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4) x, y, u, v in binned pixels of blocks of the reference drawn as an affine map (2, 3) has it."""
    height, width = current.shape
    warped = np.asarray(cv2.warpAffine(reference.image, affine, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)
    inverse = cv2.invertAffineTransform(affine)
    half = BLOCK // 2
    centres = np.round(reference.centres @ affine[:, :2].T + affine[:, 2]).astype(np.int64)
    inside = np.all((centres >= half) & (centres <= np.array([width, height]) - half), axis=1)
    found = match_blocks(warped, centres[inside], current, (0, 0))
    origin = found[:, :2] @ inverse[:, :2].T + inverse[:, 2]
    return np.column_stack([origin, found[:, :2] + found[:, 2:] - origin])


def _bin(image: NDArray[np.float32], binning: int) -> NDArray[np.float32]:
    if binning == 1:
        return image
    height, width = (n // binning * binning for n in image.shape)
    size = (width // binning, height // binning)
    return np.asarray(cv2.resize(image[:height, :width], size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _lattice(first_px: int, last_px: int, binning: int, edge: int) -> NDArray[np.int64]:
    """Centres along one axis in binned pixels, such that blocks lie in the frame."""
    count = max(2, round((last_px - first_px) / BLOCK_DISTANCE_PX) + 1)
    centres = np.round(np.linspace(first_px, last_px, count) / binning).astype(np.int64)
    return np.unique(np.clip(centres, BLOCK // 2, edge - BLOCK // 2)) if edge >= BLOCK else np.empty(0, dtype=np.int64)


def _block(image: NDArray[np.float32], cx: int, cy: int) -> NDArray[np.float32]:
    half = BLOCK // 2
    return image[cy - half : cy + half, cx - half : cx + half]


def _padded(shape: tuple[int, ...]) -> tuple[int, int]:
    """Edges that transform fast."""
    height, width = shape
    return int(fft.next_fast_len(height) or height), int(fft.next_fast_len(width, real=True) or width)


def _spectrum(image: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Spectrum of the frame, mean taken off, windowed (a frame's edges would correlate with themselves at zero shift)."""
    height, width = image.shape
    padded = _padded(image.shape)
    windowed = np.zeros(padded, dtype=np.float32)
    inside = windowed[:height, :width]
    np.subtract(image, image.mean(), out=inside)
    inside *= hann(width)
    inside *= hann(height)[:, None]
    return np.asarray(fft.rfft2(windowed, overwrite_x=True))


def candidate_shifts(spectrum: NDArray[np.complex64], current: NDArray[np.float32]) -> Iterator[tuple[tuple[int, int], float]]:
    """Whole-frame shifts (x, y) in binned pixels worth trying and their correlation, best first; no shift at all is the last."""
    height, width = _padded(current.shape)
    cross = _spectrum(current) * np.conj(spectrum)
    passed = low_pass(height, LOW_PASS)[:, None] * low_pass(width, LOW_PASS, half=True)
    # np.abs of complex numbers guards against overflow, at eight times the cost
    cross *= passed / (np.sqrt(cross.real**2 + cross.imag**2) + np.float32(1e-20))
    surface = np.asarray(fft.irfft2(cross, s=(height, width), overwrite_x=True))
    for _ in range(CANDIDATES):
        y, x = divmod(int(np.argmax(surface)), width)
        yield (x - width * (x > width // 2), y - height * (y > height // 2)), float(surface[y, x])
        rows = np.arange(y - 4, y + 5) % height
        columns = np.arange(x - 4, x + 5) % width
        surface[np.ix_(rows, columns)] = -np.inf
    yield (0, 0), 0.0


def match_blocks(
    image: NDArray[np.float32],
    centres: NDArray[np.int64],
    current: NDArray[np.float32],
    shift: tuple[int, int] | NDArray[np.int64],
    search: int = SEARCH,
) -> NDArray[np.float64]:
    """(n, 4) x, y, u, v in binned pixels of the blocks of an image found within `search` of a shift, or of one of their own."""
    shifts = np.broadcast_to(shift, centres.shape)
    found: list[tuple[float, float, float, float] | None] = [None] * len(centres)

    def match_some(first: int, last: int) -> None:
        for k in range(first, last):
            (x, y), (u, v) = centres[k].tolist(), shifts[k].tolist()
            found[k] = _match_block(_block(image, x, y), x, y, current, (u, v), search)

    parallel_chunks(match_some, len(centres), BLOCKS_AT_ONCE)
    return np.array([value for value in found if value], dtype=np.float64).reshape(-1, 4)


def _match_block(
    block: NDArray[np.float32], cx: int, cy: int, current: NDArray[np.float32], shift: tuple[int, int], search: int
) -> tuple[float, float, float, float] | None:
    """x, y, u, v of a block centred at (cx, cy); None if it is not found."""
    reach = BLOCK // 2 + search
    height, width = current.shape
    left, right = max(cx + shift[0] - reach, 0), min(cx + shift[0] + reach + 1, width)
    top, bottom = max(cy + shift[1] - reach, 0), min(cy + shift[1] + reach + 1, height)
    if right - left < BLOCK + 2 or bottom - top < BLOCK + 2:
        return None
    score = cv2.matchTemplate(current[top:bottom, left:right], block, cv2.TM_CCOEFF_NORMED)
    y, x = divmod(int(np.argmax(score)), score.shape[1])
    # Best at the edge of the search means better beyond it, unless the frame ends there: a block at the frame's edge stays at it.
    beyond_x = (x == 0 and left > 0) or (x == score.shape[1] - 1 and right < width)
    beyond_y = (y == 0 and top > 0) or (y == score.shape[0] - 1 and bottom < height)
    if not MIN_BLOCK_ZNCC <= score[y, x] <= 1.001 or beyond_x or beyond_y:
        return None
    half = BLOCK // 2
    # A block of even size is centred half a pixel before cx, cy; the field is smooth enough not to care.
    return cx, cy, left + x + half - cx + _vertex(score[y], x), top + y + half - cy + _vertex(score[:, x], y)


def _vertex(score: NDArray, at: int) -> float:
    """Position of a parabola's top about a sample of a line of scores; 0 for the first and the last."""
    if not 0 < at < score.size - 1:
        return 0.0
    before, middle, after = (float(value) for value in score[at - 1 : at + 2])
    curvature = before - 2.0 * middle + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0


def nearest_block_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """(ny, nx, 6) first guesses: the motion of the nearest block, right on both sides of a jump."""
    x, y = grid.mesh()
    _, nearest = KDTree(matches[:, :2]).query(np.column_stack([x.ravel(), y.ravel()]))
    nearest = np.asarray(nearest).reshape(grid.shape)
    seeds = np.zeros((*grid.shape, 6))
    seeds[:, :, 0] = matches[nearest, 2]
    seeds[:, :, 3] = matches[nearest, 3]
    return seeds


def smooth_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """(ny, nx, 6) first guesses: a robust affine field through the matches plus what is left of them, smoothed."""
    x, y = matches[:, 0], matches[:, 1]
    motion = matches[:, 2:]
    affine, good = _robust_affine(x, y, motion)
    residual = motion[good] - _design(x[good], y[good]) @ affine
    seeds = _affine_field(affine, grid)
    cell = max(1, FIELD_CELL_PX // grid.step_px)
    for rows in (slice(first, first + cell) for first in range(0, grid.ny, cell)):
        for columns in (slice(first, first + cell) for first in range(0, grid.nx, cell)):
            smooth = _smoothed(x[good], y[good], residual, grid.x_px[columns], grid.y_px[rows])
            seeds[rows, columns, ::3] += smooth
    return seeds


def residual_affine_field(matches: NDArray[np.float64], grid: Grid) -> NDArray[np.float64] | None:
    """(ny, nx, 6) first guesses: the affine motion that most of the matches agree on which the `smooth_field` leaves out.

    What stays where it is on the screen, such as the edge of a blank area, is found by blocks as well as what moves. None if
    those left out agree on nothing.
    """
    _, good = _robust_affine(matches[:, 0], matches[:, 1], matches[:, 2:])
    rejected = matches[~good]
    if len(rejected) < MIN_INLIERS:
        return None
    affine, agree = _robust_affine(rejected[:, 0], rejected[:, 1], rejected[:, 2:])
    if agree.sum() < max(MIN_INLIERS, len(rejected) // 2):
        return None
    return _affine_field(affine, grid)


def _affine_field(affine: NDArray[np.float64], grid: Grid) -> NDArray[np.float64]:
    """(ny, nx, 6) parameters of an affine motion, (3, 2)."""
    field = np.zeros((*grid.shape, 6))
    for axis in range(2):
        c = affine[:, axis]
        field[:, :, 3 * axis] = c[0] + c[1] * grid.x_px[None, :] + c[2] * grid.y_px[:, None]
        field[:, :, 3 * axis + 1] = c[1]
        field[:, :, 3 * axis + 2] = c[2]
    return field


def _smoothed(
    x: NDArray[np.float64], y: NDArray[np.float64], values: NDArray[np.float64], x_px: NDArray[np.float64], y_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(ny, nx, 2) Gaussian-weighted means at the crossings of columns and rows of values (n, 2) at n places, of those near."""
    width = 0.7 * BLOCK_DISTANCE_PX
    reach = FIELD_WIDTHS * width
    near = (x >= x_px[0] - reach) & (x <= x_px[-1] + reach) & (y >= y_px[0] - reach) & (y <= y_px[-1] + reach)
    gx = np.exp(-0.5 * ((x_px[:, None] - x[near]) / width) ** 2)
    gy = np.exp(-0.5 * ((y_px[:, None] - y[near]) / width) ** 2)
    weight = _product(gy, gx) + 1e-3
    return np.stack([_product(gy * values[near, axis], gx) / weight for axis in range(2)], axis=-1)


def _product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """``a @ b.T``, not by BLAS, whose threads go on spinning after a product as small as this (48 ms of processor time for 1 ms)."""
    return np.einsum("ik,jk->ij", a, b)


def _design(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.ones_like(x), x, y])


def _robust_affine(
    x: NDArray[np.float64], y: NDArray[np.float64], motion: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(3, 2) affine coefficients of the motion by reweighted least squares (Cauchy), and which matches agree with it."""
    affine = np.zeros((3, 2))
    affine[0] = [median_of(motion[:, axis]) for axis in range(2)]
    design = _design(x, y)
    for _ in range(10 if _determined(x, y) else 0):
        root = 1.0 / np.sqrt(1.0 + (_length(motion - design @ affine) / OUTLIER_PX) ** 2)
        before = affine
        affine = np.asarray(np.linalg.lstsq(design * root[:, None], motion * root[:, None], rcond=None)[0], dtype=np.float64)
        if np.abs(design @ (affine - before)).max() < SETTLED_PX:
            break
    return affine, _length(motion - design @ affine) <= OUTLIER_PX


def _determined(x: NDArray[np.float64], y: NDArray[np.float64]) -> bool:
    """Whether places tell an affine map: enough of them, spread out, and not along one line."""
    if len(x) < 6 or max(x.max() - x.min(), y.max() - y.min()) <= BLOCK_DISTANCE_PX:
        return False
    dx, dy = x - x.mean(), y - y.mean()
    xx, xy, yy = float(dx @ dx), float(dx @ dy), float(dy @ dy)
    across = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)  # sum of squared distances from the line through them
    return bool(across > 1.0)


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each of (n, 2) vectors."""
    return np.sqrt(vectors[:, 0] ** 2 + vectors[:, 1] ** 2)
