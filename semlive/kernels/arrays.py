"""Checks of arrays at the interface of compiled kernels, the size of one task of a thread, and copies in kernels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import DTypeLike, NDArray

ROW_CHUNK = 4  # rows of POI per task of a thread; constant
PIXEL_CHUNK = 98304  # pixels per task of a thread; for fewer, starting a thread takes longer than it saves


def lines_at_once(width: int) -> int:
    """Number of lines of an image of this width per task of a thread."""
    return max(1, PIXEL_CHUNK // width)


def checked(array: object, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> NDArray:
    """The array itself if it is C-contiguous and of this dtype and shape (None: any length).

    Raises:
        ValueError: dtype, shape or layout differ.
    """
    if not isinstance(array, np.ndarray):
        raise ValueError(f"{name} must be an array, not {type(array).__name__}")
    if array.dtype != np.dtype(dtype):
        raise ValueError(f"{name} must be {np.dtype(dtype)}, not {array.dtype}")
    if array.ndim != len(shape) or any(length not in (None, size) for size, length in zip(array.shape, shape, strict=True)):
        raise ValueError(f"{name} must have shape {tuple('any' if n is None else n for n in shape)}, not {array.shape}")
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} must be C-contiguous")
    return array


@njit(nogil=True, cache=True)
def copy_line(target, source):
    """Target <- source, both (n,).

    With an assignment to a slice every kernel also contains the code that writes the message about unequal shapes: compiling it took 4 s,
    and loading the kernels at every start a tenth longer.
    """
    for k in range(target.size):
        target[k] = source[k]
