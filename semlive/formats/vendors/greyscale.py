"""Conversion of stored pixels to one grey channel, and checks of the content."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadImage
from semlive.formats.vendors.tiff import Photometric

_GREY_FRACTION = 0.99  # of all pixels; the rest may be coloured annotation
_RAMP_FRACTION = 0.9  # of the palette's grey entries; isolated grey entries may be annotation


def to_greyscale(
    name: str, pixels: NDArray[np.generic], photometric: int, palette: list[int] | None = None
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Convert pixels to one grey channel of 8 or 16 bit.

    Args:
        name: file name, for the message.
        pixels: (height, width) or (height, width, samples) as stored.
        photometric: value of the TIFF tag for the meaning of the numbers.
        palette: TIFF colour map (all reds, all greens, all blues), if the numbers are indices into it.

    Raises:
        BadImage: colours, or numbers that are not 8 or 16 bit unsigned.
    """
    if pixels.dtype not in (np.uint8, np.uint16):
        raise BadImage(f"{name}: has {pixels.dtype} pixels; export 8 or 16 bit grey.")
    if pixels.ndim == 3:
        pixels = _one_channel(name, pixels)
    elif photometric == Photometric.PALETTE and palette:
        _check_palette(name, pixels, palette)
    invert = photometric == Photometric.WHITE_IS_ZERO
    if pixels.dtype == np.uint8:
        narrow = np.array(pixels, dtype=np.uint8, order="C")
        return np.bitwise_not(narrow) if invert else narrow
    wide = np.array(pixels, dtype=np.uint16, order="C")
    return np.bitwise_not(wide) if invert else wide


def check_content(name: str, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Refuse an image that is not a finished scan: a constant image, or one that ends in uniform rows.

    Two uniform rows are sufficient evidence: a preallocated, half-filled file decodes without error and ends in hundreds of zero
    rows, while two scanned rows of a thousand noisy pixels are never uniform.

    Raises:
        BadImage: the image is constant or ends in uniform rows.
    """
    if int(image.min()) == int(image.max()):
        raise BadImage(f"{name}: every pixel is {int(image.flat[0])}; check the detector and export it again.")
    blank = count_blank_rows(image)
    if blank >= 2:
        raise BadImage(
            f"{name}: its last {blank} rows are uniform, so the scan was not finished when it was saved, or they are a databar; "
            "save only finished frames, or set sem.profile.databar_rows."
        )


def count_blank_rows(image: NDArray[np.uint8] | NDArray[np.uint16]) -> int:
    """Return the number of uniform rows at the bottom of an image."""
    uniform = (image == image[:, :1]).all(axis=1)
    return int(uniform.size if uniform.all() else np.argmin(uniform[::-1]))


def _one_channel(name: str, pixels: NDArray[np.generic]) -> NDArray[np.generic]:
    # An alpha channel contains no information about the specimen.
    colours = pixels[..., : 3 if pixels.shape[2] >= 3 else 1]
    if (colours == colours[..., :1]).all(axis=2).mean() <= _GREY_FRACTION:
        raise BadImage(f"{name}: is a colour image; export grey, without coloured overlays.")
    return colours[..., 0]


def _check_palette(name: str, pixels: NDArray[np.generic], palette: list[int]) -> None:
    # SEM programs write grey ramps in which some entries are coloured for annotation (Zeiss); the index is the grey value.
    colours = np.array(palette[: len(palette) // 3 * 3]).reshape(3, -1)
    if colours.shape[1] <= int(pixels.max()):
        raise BadImage(f"{name}: its palette is shorter than its grey values; export grey.")
    grey = (colours == colours[0]).all(axis=0)
    ramp = (np.diff(colours[0][grey]) >= 0).mean() if grey.sum() > 1 else 0.0
    if grey[pixels].mean() <= _GREY_FRACTION or ramp < _RAMP_FRACTION:
        raise BadImage(f"{name}: is in false colours; export grey.")
