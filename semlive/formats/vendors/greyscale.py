"""Conversion of stored pixels to one grey channel, and checks of the content."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadImage
from semlive.formats.vendors.tiff_pixels import Photometric

_GREY_FRACTION = 0.99  # of all pixels; the rest may be coloured annotation
_WHITE_8, _WHITE_16 = 255, 65535
_RAMP_FRACTION = 0.9  # of the palette's grey entries; isolated grey entries may be annotation


def to_greyscale(
    name: str, pixels: NDArray[np.generic], photometric: int, palette: list[int] | None = None, bits: int | None = None
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Convert pixels to one grey channel of 8 or 16 bit, dark is zero.

    Signed numbers are shifted by half their range. Fractions and numbers of more than 16 bit are refused: a scale that is made from one
    frame would change from frame to frame.

    Args:
        name: file name, for the message.
        pixels: (height, width) or (height, width, samples) as stored.
        photometric: value of the TIFF tag for the meaning of the numbers.
        palette: TIFF colour map (all reds, all greens, all blues), if the numbers are indices into it.
        bits: bits of a sample; None if the numbers use all bits of their type.

    Raises:
        BadImage: colours, or numbers that are not whole numbers of 8 or 16 bit.
    """
    if pixels.ndim == 3:
        pixels = _one_channel(name, pixels)
    whole = _unsigned(name, pixels)
    if photometric == Photometric.PALETTE and palette:
        return _through_palette(name, whole, palette)
    if photometric != Photometric.WHITE_IS_ZERO:
        return whole
    white = 2 ** min(bits or 16, 8 * whole.itemsize) - 1
    return white - whole


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


def _unsigned(name: str, pixels: NDArray[np.generic]) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return a contiguous array of unsigned whole numbers of 8 or 16 bit."""
    numbers = np.ascontiguousarray(pixels)
    if numbers.dtype in (np.uint8, np.int8):
        narrow = numbers.view(np.uint8)
        return narrow if numbers.dtype == np.uint8 else narrow ^ np.uint8(0x80)
    if numbers.dtype in (np.uint16, np.int16):
        wide = numbers.view(np.uint16)
        return wide if numbers.dtype == np.uint16 else wide ^ np.uint16(0x8000)
    raise BadImage(f"{name}: has {pixels.dtype.name} pixels; export 8 or 16 bit grey.")


def _through_palette(
    name: str, indices: NDArray[np.uint8] | NDArray[np.uint16], palette: list[int]
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the grey levels of indices into a colour map: the indices themselves if the map is the ramp of all grey levels.

    SEM programs write such ramps, in which some entries are coloured for annotation (Zeiss).
    """
    colours = np.array(palette[: len(palette) // 3 * 3], dtype=np.int64).reshape(3, -1)
    size = colours.shape[1]
    if size <= np.iinfo(indices.dtype).max and size <= int(indices.max()):
        raise BadImage(f"{name}: its palette is shorter than its grey values; export grey.")
    grey = (colours == colours[0]).all(axis=0)
    steps = np.diff(colours[0][grey])
    ramp = max((steps >= 0).mean(), (steps <= 0).mean()) if grey.sum() > 1 else 0.0
    used = 1.0 if grey.all() else np.count_nonzero(grey[indices]) / indices.size
    if used <= _GREY_FRACTION or ramp < _RAMP_FRACTION:
        raise BadImage(f"{name}: is in false colours; export grey.")
    full = _WHITE_16 if colours.max() > _WHITE_8 else _WHITE_8  # some programs write 8 bit colour maps
    levels = np.rint(colours[0] * ((size - 1) / full))
    if (np.abs(levels - np.arange(size))[grey] <= 1).mean() >= _RAMP_FRACTION:  # the others are annotation in black or white
        return indices
    return levels.astype(indices.dtype)[indices]
