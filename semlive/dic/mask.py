"""Mask of the reference frame: the part of the specimen that is not correlated.

Masks are drawn on the specimen in frame 0. In a later frame that is a reference itself, the mask follows the shift of the specimen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.settings import DicSettings
from semlive.dic.initial_guess.search import match
from semlive.dic.reference import Reference
from semlive.errors import BadInput
from semlive.inputs.mask_file import Mask, read_mask
from semlive.kernels import images


def mask_of(settings: DicSettings, shape: tuple[int, int]) -> Mask | None:
    """Return the mask of a frame: (height, width), True where it may be used; None without a mask.

    Args:
        settings: of the correlation, with the embedded mask.
        shape: (height, width) of the frame.

    Raises:
        BadInput: the mask has another size than the frame, or is not embedded.
    """
    if settings.mask is None:
        return None
    mask = read_mask(settings.mask)
    if mask.shape != shape:
        (height, width), (rows, columns) = mask.shape, shape
        raise BadInput(
            f"the mask is {width} x {height} px but the frame {columns} x {rows} px: draw it on a frame of the run, without its databar "
            "(semlive init --test-frame)"
        )
    return mask


def moved_mask(mask: Mask, reference: Reference, image: NDArray[np.uint8] | NDArray[np.uint16]) -> Mask:
    """Return the mask of frame 0 at the place of the specimen in another frame.

    The shift is the median of the blocks that the search for initial guesses finds, in integer pixels; rows and columns that enter the
    frame have the value at its edge. Without any such block the mask stays.

    Args:
        mask: (height, width) mask of frame 0.
        reference: frame 0, prepared.
        image: (height, width) other frame.
    """
    blocks = match(reference.coarse, images.to_float32_grey(image))
    if not len(blocks):
        return mask
    dx, dy = (int(shift) for shift in np.rint(np.median(blocks[:, 2:], axis=0)))
    height, width = mask.shape
    rows, columns = np.clip(np.arange(height) - dy, 0, height - 1), np.clip(np.arange(width) - dx, 0, width - 1)
    return mask[np.ix_(rows, columns)]
