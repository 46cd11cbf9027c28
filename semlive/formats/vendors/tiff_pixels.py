"""The pixels of a TIFF file, decoded by tifffile and imagecodecs in the order in which they are stored.

Compression, predictors, strips and tiles, planes, byte order and packed samples follow the TIFF 6.0 specification (Deflate: technical
note 2; Zstandard: libtiff). The Orientation tag is not applied, because stored rows are scan rows. Memory: the decoded image, which
`check_size` limits, and one decoded strip or tile, which may not be larger than the image, rounded up to the size of a tile.
"""

from __future__ import annotations

import math
import struct
from enum import IntEnum
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadImage
from semlive.formats.vendors.image_size import check_inflation, check_size
from semlive.formats.vendors.tiff import Directory, Tag, check_complete
from semlive.formats.vendors.tiff_pages import Page

_JPEG = 7
_COMPRESSIONS = {1: "none", 5: "LZW", _JPEG: "JPEG", 8: "Deflate", 32773: "PackBits", 32946: "Deflate", 50000: "Zstandard"}
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # SOF markers, ITU-T T.81 table B.1
_ALPHA = {1, 2}
_UNSIGNED, _SIGNED = 1, 2
_FORMATS = {_UNSIGNED: "unsigned", _SIGNED: "signed", 3: "floating point", 5: "complex whole numbers", 6: "complex"}


class Photometric(IntEnum):
    """Meaning of the numbers of a pixel."""

    WHITE_IS_ZERO = 0
    BLACK_IS_ZERO = 1
    RGB = 2
    PALETTE = 3
    YCBCR = 6


def read_pixels(data: bytes, name: str, page: Page) -> NDArray[np.generic]:
    """Return the pixels of an image as stored: (height, width) or (height, width, samples).

    Raises:
        BadImage: the file is incomplete, its pixels are of an unknown kind or would exhaust the memory, or they cannot be decoded.
    """
    missing = check_complete(data)
    if missing is not None:
        raise BadImage(f"{name}: not a complete TIFF file ({missing}); export it again.")
    samples = max(page.directory.integer(data, Tag.SAMPLES_PER_PIXEL, 1), 1)
    compression = page.directory.integer(data, Tag.COMPRESSION, 1)
    bits = _check_kind(data, name, page.directory, samples, compression)
    check_size(name, page.width_px, page.rows, samples, -(-bits // 8))
    check_inflation(name, page.width_px * page.rows * samples * bits // 8, len(data), compressed=compression != 1)
    try:
        pixels = _decode(data, name, page, compression, samples)
    except BadImage:
        raise
    except Exception as exc:  # tifffile raises many types of errors on damaged files
        reason = (str(exc).splitlines() or [type(exc).__name__])[0]
        raise BadImage(f"{name}: its pixels cannot be decoded ({reason}); export it again.") from exc
    if pixels.shape[:2] != (page.rows, page.width_px):
        raise BadImage(f"{name}: decodes to {pixels.shape[:2]}, but its tags state {(page.rows, page.width_px)}; export it again.")
    native = pixels.astype(pixels.dtype.newbyteorder("="), copy=False)
    return _without_extra_samples(data, name, page.directory, native)


def bits_per_sample(data: bytes, directory: Directory) -> int:
    """Return the number of bits of a sample, 1 if the file does not contain it."""
    return directory.integer(data, Tag.BITS_PER_SAMPLE, 1)


def _check_kind(data: bytes, name: str, directory: Directory, samples: int, compression: int) -> int:
    """Return the bits per sample of an image that can be decoded."""
    bits = set(directory.integers(data, Tag.BITS_PER_SAMPLE)) or {1}
    formats = set(directory.integers(data, Tag.SAMPLE_FORMAT)) or {1}
    photometric = directory.integer(data, Tag.PHOTOMETRIC, Photometric.RGB if samples > 2 else Photometric.BLACK_IS_ZERO)
    if compression not in _COMPRESSIONS:
        readable = ", ".join(dict.fromkeys(_COMPRESSIONS.values()))
        raise BadImage(f"{name}: is compressed by method {compression}, which is not read ({readable} are); export it uncompressed.")
    if len(bits) > 1 or not 8 <= min(bits) <= 16 or formats not in ({_UNSIGNED}, {_SIGNED}):
        kinds = " and ".join(_FORMATS.get(code, f"format {code}") for code in sorted(formats))
        raise BadImage(f"{name}: has samples of {', '.join(map(str, sorted(bits)))} bit ({kinds}); export 8 or 16 bit grey.")
    if compression == 1 and directory.integer(data, Tag.PREDICTOR, 1) != 1:
        raise BadImage(f"{name}: has a predictor but no compression, which programs read in two ways; export it without a predictor.")
    if photometric not in set(Photometric) or (photometric == Photometric.YCBCR and compression != _JPEG):
        raise BadImage(f"{name}: has pixels in colour space {photometric} (PhotometricInterpretation); export 8 or 16 bit grey.")
    return bits.pop()


def _decode(data: bytes, name: str, page: Page, compression: int, samples: int) -> NDArray[np.generic]:
    import tifffile  # noqa: PLC0415  (the control process reads headers and decodes no image)

    with tifffile.TiffFile(BytesIO(data)) as tiff:
        decoded = tiff.pages[page.index]
        # tifffile applies special rules to some vendors, so the sizes that it will allocate are checked again.
        sample_bytes = 8 if decoded.dtype is None else decoded.dtype.itemsize
        image_bytes, segment_bytes = (math.prod(shape) * sample_bytes for shape in (decoded.shape, decoded.chunks))
        if len(decoded.shape) not in (2, 3) or math.prod(decoded.shape) != page.width_px * page.rows * samples:
            raise BadImage(f"{name}: is a stack of shape {decoded.shape}; export single frames.")
        if segment_bytes > max(4 * image_bytes, 2**22):
            raise BadImage(f"{name}: has tiles of {decoded.chunks} px, far more than its image; export it again.")
        if compression == _JPEG:
            _check_jpeg(data, name, page.directory, segment_bytes)
        image = decoded.asarray(maxworkers=1)
        planar = decoded.axes == "SYX"
    return np.moveaxis(image, 0, 2) if planar else image


def _check_jpeg(data: bytes, name: str, directory: Directory, largest_bytes: int) -> None:
    """Refuse JPEG strips or tiles that state more pixels than their place has: the decoder allocates what they state."""
    tiled = Tag.TILE_OFFSETS in directory.tags
    offsets = directory.integers(data, Tag.TILE_OFFSETS if tiled else Tag.STRIP_OFFSETS)
    lengths = directory.integers(data, Tag.TILE_BYTES if tiled else Tag.STRIP_BYTES)
    for offset, length in zip(offsets, lengths, strict=True):
        at, end = offset + 2, offset + length
        while at + 10 <= end and data[at] == 0xFF and data[at + 1] not in _JPEG_FRAMES:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
        rows, width, components = struct.unpack_from(">HHB", data, at + 5) if at + 10 <= end else (0, 0, 0)
        if not 0 < rows * width * components <= largest_bytes:
            raise BadImage(f"{name}: a JPEG strip of it states {width} x {rows} px with {components} samples; export it again.")


def _without_extra_samples(data: bytes, name: str, directory: Directory, pixels: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return grey pixels without their transparency; a second signal is refused, because the file does not name the one that is meant."""
    grey = directory.integer(data, Tag.PHOTOMETRIC, Photometric.BLACK_IS_ZERO) <= Photometric.BLACK_IS_ZERO
    if pixels.ndim == 2 or not grey:
        return pixels
    extra = directory.integers(data, Tag.EXTRA_SAMPLES)
    only_alpha = len(extra) == pixels.shape[2] - 1 and set(extra) <= _ALPHA
    if not only_alpha and (pixels != pixels[..., :1]).any():
        raise BadImage(f"{name}: has {pixels.shape[2]} signals for each pixel; export one signal.")
    return pixels[..., 0]
