"""Grey scale that an image uses: many detectors deliver 10, 12 or 14 bits in 16 bit files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_BITS = 8  # a dark image of few grey levels has no smaller scale than a detector


@dataclass(frozen=True, slots=True)
class GreyScale:
    """Grey scale of an image.

    Attributes:
        quantum: distance of neighbouring grey levels; 257 or 256 for 8 bits that were stretched to 16.
        full_scale: largest grey level that the detector can deliver.
    """

    quantum: int
    full_scale: int


def grey_scale(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> GreyScale:
    """Return the grey scale of an image from its data.

    The quantum is the greatest common divisor of all differences of grey levels. The full scale is the smallest 8, 9, ... 16 bit
    scale of this quantum that contains the largest grey level. An 8 bit file always has the scale 0 to 255.

    Args:
        pixels: uint8 or uint16 of any shape, at least one.

    Raises:
        ValueError: no pixel, or another type.
    """
    if pixels.dtype not in (np.uint8, np.uint16) or not pixels.size:
        raise ValueError(f"pixels must be uint8 or uint16, and at least one, not {pixels.size} of {pixels.dtype}")
    largest_of_type = int(np.iinfo(pixels.dtype).max)
    if pixels.dtype == np.uint8:
        return GreyScale(1, largest_of_type)
    used = np.zeros(largest_of_type + 1, dtype=np.bool_)
    used[pixels.ravel()] = True
    levels = np.flatnonzero(used)
    quantum = int(np.gcd.reduce(np.diff(levels))) if levels.size > 1 else 1
    if int(levels[0]) % quantum:  # an offset: grey levels are no multiples of the quantum
        quantum = 1
    bits = max(MIN_BITS, int(levels[-1] // quantum).bit_length())
    return GreyScale(quantum, min(((1 << bits) - 1) * quantum, largest_of_type))
