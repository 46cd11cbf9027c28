"""Matching of blocks of a reference image in a current image by ZNCC, in binned pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.kernels.threads import parallel_chunks

BLOCK = 32  # edge of a block, in binned pixels
SEARCH = 16  # search radius around the shift of the frame, in binned pixels
MIN_BLOCK_ZNCC = 0.5  # the best of 33 x 33 unrelated positions stays below 0.35 for 7 px speckle
BLOCKS_PER_CHUNK = 8  # blocks of one task of a thread


def block_at(image: NDArray[np.float32], cx: int, cy: int) -> NDArray[np.float32]:
    """Block of an image around a centre."""
    half = BLOCK // 2
    return image[cy - half : cy + half, cx - half : cx + half]


def match_blocks(
    image: NDArray[np.float32],
    centres: NDArray[np.int64],
    current: NDArray[np.float32],
    shift: tuple[int, int] | NDArray[np.int64],
    search: int = SEARCH,
) -> NDArray[np.float64]:
    """Return (n, 4) x, y, u, v in binned pixels of the blocks of an image that were found.

    Args:
        image: (h, w) reference image.
        centres: (m, 2) block centres (x, y).
        current: (h, w) current image.
        shift: expected motion (x, y), one for all blocks or (m, 2).
        search: search radius around the expected motion.
    """
    shifts = np.broadcast_to(shift, centres.shape)
    matches: list[tuple[float, float, float, float] | None] = [None] * len(centres)

    def match_some(first: int, last: int) -> None:
        for k in range(first, last):
            (x, y), (u, v) = centres[k].tolist(), shifts[k].tolist()
            matches[k] = _match_block(block_at(image, x, y), x, y, current, (u, v), search)

    parallel_chunks(match_some, len(centres), BLOCKS_PER_CHUNK)
    return np.array([value for value in matches if value], dtype=np.float64).reshape(-1, 4)


def _match_block(
    block: NDArray[np.float32], cx: int, cy: int, current: NDArray[np.float32], shift: tuple[int, int], search: int
) -> tuple[float, float, float, float] | None:
    """Match (x, y, u, v) of a block centred at (cx, cy); None if it is not found."""
    half_width = BLOCK // 2 + search
    height, width = current.shape
    left, right = max(cx + shift[0] - half_width, 0), min(cx + shift[0] + half_width + 1, width)
    top, bottom = max(cy + shift[1] - half_width, 0), min(cy + shift[1] + half_width + 1, height)
    if right - left < BLOCK + 2 or bottom - top < BLOCK + 2:
        return None
    score = cv2.matchTemplate(current[top:bottom, left:right], block, cv2.TM_CCOEFF_NORMED)
    y, x = divmod(int(np.argmax(score)), score.shape[1])
    # A maximum at the edge of the search area has a larger value beyond it, unless the area ends at the edge of the frame.
    beyond_x = (x == 0 and left > 0) or (x == score.shape[1] - 1 and right < width)
    beyond_y = (y == 0 and top > 0) or (y == score.shape[0] - 1 and bottom < height)
    if not MIN_BLOCK_ZNCC <= score[y, x] <= 1.001 or beyond_x or beyond_y:
        return None
    half_block = BLOCK // 2
    # The centre of a block of even size is half a pixel before cx, cy; the field is smooth enough to neglect this.
    return cx, cy, left + x + half_block - cx + _vertex(score[y], x), top + y + half_block - cy + _vertex(score[:, x], y)


def _vertex(score: NDArray, at: int) -> float:
    """Sub-pixel offset of the maximum of a parabola through three scores; 0 at the ends of the line."""
    if not 0 < at < score.size - 1:
        return 0.0
    before, middle, after = (float(value) for value in score[at - 1 : at + 2])
    curvature = before - 2.0 * middle + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
