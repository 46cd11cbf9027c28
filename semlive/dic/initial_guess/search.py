"""Search for the blocks of a reference frame in a current frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from semlive.data.grid import Grid
from semlive.dic.initial_guess.affine_fit import BLOCK_DISTANCE_PX, MIN_INLIERS, robust_affine
from semlive.dic.initial_guess.block_matching import BLOCK, SEARCH, block_at, match_blocks
from semlive.dic.initial_guess.frame_shift import candidate_shifts, frame_spectrum, padded_shape
from semlive.dic.initial_guess.periodicity import ambiguous

ROTATION_CANDIDATES = (-9.0, -6.0, -3.0, 3.0, 6.0, 9.0)  # degrees


@dataclass(frozen=True, slots=True, eq=False)
class InitialGuessReference:
    """Binned reference frame for initial guesses.

    Attributes:
        binning: pixels per binned pixel, 2, or 1 for small frames.
        image: (h, w) binned float32 grey levels.
        spectrum: spectrum of the windowed, padded image.
        centres: (n, 2) block centres (x, y) in binned pixels, where the image has contrast and does not repeat.
        ambiguous: (ny, nx) points whose subsets repeat within the search range.
        search: largest possible motion along x or y in binned pixels; None if unknown.
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
    spectrum = frame_spectrum(binned)
    repeating = ambiguous(binned, spectrum, padded_shape(binned.shape), grid, binning, search_px)

    i = np.clip(np.round((x * binning - grid.x0_px) / grid.step_px).astype(np.intp), 0, grid.nx - 1)
    j = np.clip(np.round((y * binning - grid.y0_px) / grid.step_px).astype(np.intp), 0, grid.ny - 1)
    unique = ~repeating[np.ix_(j, i)]
    centres = [(cx, cy) for k, cy in enumerate(y) for cx in x[unique[k]] if np.ptp(block_at(binned, cx, cy)) > 0]
    return InitialGuessReference(
        binning=binning,
        image=binned,
        spectrum=spectrum,
        centres=np.array(centres, dtype=np.int64).reshape(-1, 2),
        ambiguous=repeating,
        search=None if search_px is None else int(np.ceil(search_px / binning)) + 1,
    )


def match(reference: InitialGuessReference, image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return (n, 4) x, y, u, v in px of the blocks of the reference that were found in the current frame; n may be 0.

    Args:
        reference: from `prepare_coarse`.
        image: (height, width) current frame, float32 grey levels.
    """
    current = _bin(image, reference.binning)
    limit = reference.search
    if limit is not None and limit <= SEARCH:
        return match_blocks(reference.image, reference.centres, current, (0, 0), limit) * reference.binning
    sufficient = max(1, len(reference.centres) // 2)
    best = np.empty((0, 4))
    for shift, _ in candidate_shifts(reference.spectrum, current):
        if limit is not None and max(abs(shift[0]), abs(shift[1])) > limit:
            continue
        matches = match_blocks(reference.image, reference.centres, current, shift)
        if len(matches) > len(best):
            best = matches
        if len(best) >= sufficient:
            break
    if len(best) < sufficient:
        best = search(reference, current, best)
    return best * reference.binning


def search(reference: InitialGuessReference, current: NDArray[np.float32], matches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 4) x, y, u, v in binned pixels if a shift of the frame finds less than half of the blocks.

    An affine map through the blocks that agree predicts the others. If too few agree, rotations up to 9 degrees in steps of
    3 degrees are tried (blocks still correlate at half a step).

    Args:
        reference: from `prepare_coarse`.
        current: binned current frame.
        matches: (n, 4) matches of the shift.
    """
    min_matches = max(MIN_INLIERS, len(reference.centres) // 8)
    matches = _extend_matches(reference, current, matches)
    best = _affine_matches(reference, current, matches)
    if len(best) >= min_matches:
        return best
    height, width = reference.image.shape
    trials = []
    for degrees in ROTATION_CANDIDATES:
        rotation = cv2.getRotationMatrix2D((width / 2.0, height / 2.0), degrees, 1.0)
        rotated = np.asarray(cv2.warpAffine(reference.image, rotation, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)
        shift, peak = next(candidate_shifts(frame_spectrum(rotated), current))
        trials.append((peak, degrees, rotation + np.array([[0, 0, shift[0]], [0, 0, shift[1]]])))
    for _, _, affine in sorted(trials, key=lambda t: (-t[0], t[1]))[:2]:
        candidate = _affine_matches(reference, current, warped_blocks(reference, current, affine))
        if len(candidate) > len(best):
            best = candidate
    return best if len(best) else matches


def _extend_matches(reference: InitialGuessReference, current: NDArray[np.float32], matches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matches, and blocks found around the motion of their nearest match, repeated until no block is added."""
    while 0 < len(matches) < len(reference.centres):
        unmatched = np.array([centre for centre in reference.centres if not (centre == matches[:, :2]).all(axis=1).any()])
        _, nearest = KDTree(matches[:, :2]).query(unmatched)
        added = match_blocks(reference.image, unmatched, current, np.round(matches[nearest, 2:]).astype(np.int64))
        if not len(added):
            break
        matches = np.concatenate([matches, added])
    return matches


def _affine_matches(reference: InitialGuessReference, current: NDArray[np.float32], matches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matches around the affine map on which the given matches agree; empty without agreement."""
    min_matches = max(MIN_INLIERS, len(reference.centres) // 8)
    best = np.empty((0, 4))
    for _ in range(2):
        if len(matches) < MIN_INLIERS:
            break
        coefficients, inliers = robust_affine(matches[:, 0], matches[:, 1], matches[:, 2:])
        if inliers.sum() < max(MIN_INLIERS, len(matches) // 2):
            break
        if len(matches) > len(best):
            best = matches
        c = coefficients
        affine = np.array([[1.0 + c[1, 0], c[2, 0], c[0, 0]], [c[1, 1], 1.0 + c[2, 1], c[0, 1]]])
        matches = warped_blocks(reference, current, affine)
    return best if len(matches) <= len(best) or len(matches) < min_matches else matches


def warped_blocks(reference: InitialGuessReference, current: NDArray[np.float32], affine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 4) x, y, u, v in binned pixels of blocks of the reference warped by an affine map (2, 3)."""
    height, width = current.shape
    warped = np.asarray(cv2.warpAffine(reference.image, affine, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)
    inverse = cv2.invertAffineTransform(affine)
    half_block = BLOCK // 2
    centres = np.round(reference.centres @ affine[:, :2].T + affine[:, 2]).astype(np.int64)
    inside = np.all((centres >= half_block) & (centres <= np.array([width, height]) - half_block), axis=1)
    matches = match_blocks(warped, centres[inside], current, (0, 0))
    origin = matches[:, :2] @ inverse[:, :2].T + inverse[:, 2]
    return np.column_stack([origin, matches[:, :2] + matches[:, 2:] - origin])


def _bin(image: NDArray[np.float32], binning: int) -> NDArray[np.float32]:
    if binning == 1:
        return image
    height, width = (n // binning * binning for n in image.shape)
    size = (width // binning, height // binning)
    return np.asarray(cv2.resize(image[:height, :width], size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _lattice(first_px: int, last_px: int, binning: int, edge: int) -> NDArray[np.int64]:
    """Block centres along one axis in binned pixels; all blocks lie in the frame."""
    count = max(2, round((last_px - first_px) / BLOCK_DISTANCE_PX) + 1)
    centres = np.round(np.linspace(first_px, last_px, count) / binning).astype(np.int64)
    return np.unique(np.clip(centres, BLOCK // 2, edge - BLOCK // 2)) if edge >= BLOCK else np.empty(0, dtype=np.int64)
