"""TIFF files in every layout, against the array from which they were made, and against libtiff inside Pillow."""

from __future__ import annotations

import io
import itertools

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from semlive.data.frame import ExportedFile
from semlive.formats.images.frames import parse_file, read_pixels

COMPRESSIONS = (None, "lzw", "zlib", "packbits", "zstd")
PREDICTORS = (False, True)
LAYOUTS = ({"rowsperstrip": 7}, {"rowsperstrip": 2**32 - 1}, {"tile": (16, 32)})
ORDERS = ("<", ">")
KINDS = (np.uint8, np.uint16, np.int8, np.int16)
PHOTOMETRICS = ("minisblack", "miniswhite")
SHAPE = (45, 50)  # no multiple of a strip or tile
MATRIX = [
    combination
    for combination in itertools.product(COMPRESSIONS, PREDICTORS, range(len(LAYOUTS)), ORDERS, range(2))
    if combination[0] or not combination[1]
]


def picture(kind: type[np.generic]) -> NDArray[np.generic]:
    """Smooth enough to compress, and with every bit of the type."""
    info = np.iinfo(kind)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ramp = (x * 3 + y * 5) / (SHAPE[1] * 3 + SHAPE[0] * 5)
    noise = np.random.default_rng(3).normal(0, 0.02, SHAPE)
    return np.clip(info.min + (ramp + noise) * (int(info.max) - int(info.min)), info.min, info.max).astype(kind)


def grey_levels(image: NDArray[np.generic], photometric: str) -> NDArray[np.unsignedinteger]:
    """The rule of the reader, written in another way: shift signed numbers to zero, then invert."""
    info = np.iinfo(image.dtype)
    shifted = image.astype(np.int64) - info.min
    levels = int(info.max) - int(info.min) - shifted if photometric == "miniswhite" else shifted
    return levels.astype(np.uint8 if image.itemsize == 1 else np.uint16)


def decoded(data: bytes) -> NDArray[np.unsignedinteger]:
    return read_pixels(parse_file(ExportedFile(0, "a.tif", data, "", 1, 1)))


@pytest.mark.parametrize("number", range(len(MATRIX)), ids=lambda number: "-".join(map(str, MATRIX[number])))
def test_every_layout_gives_the_grey_levels_that_were_stored(number: int) -> None:
    compression, predictor, layout, order, signed = MATRIX[number]
    kind = KINDS[2 * signed + number % 2]
    photometric, big, orientation = PHOTOMETRICS[number // 2 % 2], bool(number // 4 % 2), (1, 3, 6)[number % 3]
    image = picture(kind)
    stream = io.BytesIO()
    tifffile.imwrite(
        stream,
        image,
        compression=compression,
        predictor=predictor,
        byteorder=order,
        bigtiff=big,
        photometric=photometric,
        metadata=None,
        extratags=[(274, "H", 1, orientation, True)],
        **LAYOUTS[layout],
    )
    data = stream.getvalue()
    assert np.array_equal(decoded(data), grey_levels(image, photometric))
    notes = parse_file(ExportedFile(0, "a.tif", data, "", 1, 1)).header.notes
    assert any("Orientation" in note for note in notes) == (orientation != 1)


@pytest.mark.parametrize("planar", ["contig", "separate"])
@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_grey_in_three_planes_is_read(planar: str, compression: str | None, kind: type[np.generic]) -> None:
    image = picture(kind)
    stream = io.BytesIO()
    axis = 2 if planar == "contig" else 0
    tifffile.imwrite(
        stream, np.stack([image] * 3, axis=axis), photometric="rgb", planarconfig=planar, compression=compression, rowsperstrip=16
    )
    assert np.array_equal(decoded(stream.getvalue()), image)


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "tiff_adobe_deflate", "packbits"])
@pytest.mark.parametrize("predictor", [1, 2])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_files_of_libtiff_give_what_libtiff_reads(compression: str, predictor: int, kind: type[np.generic]) -> None:
    image = picture(kind)
    stream = io.BytesIO()
    has_predictor = predictor == 2 and compression in ("tiff_lzw", "tiff_adobe_deflate")
    Image.fromarray(image).save(stream, "TIFF", compression=compression, tiffinfo={317: 2} if has_predictor else {})
    data = stream.getvalue()
    assert np.array_equal(decoded(data), np.asarray(Image.open(io.BytesIO(data))))
    assert np.array_equal(decoded(data), image)


def test_grey_in_jpeg_colours_gives_what_libtiff_reads() -> None:
    stream = io.BytesIO()
    Image.fromarray(np.stack([picture(np.uint8)] * 3, axis=2)).save(stream, "TIFF", compression="jpeg", quality=95)
    other = np.asarray(Image.open(io.BytesIO(stream.getvalue())).convert("L")).astype(int)
    assert np.abs(decoded(stream.getvalue()).astype(int) - other).max() <= 1


def test_jpeg_strips_give_what_libtiff_reads() -> None:
    stream = io.BytesIO()
    Image.fromarray(picture(np.uint8)).save(stream, "TIFF", compression="jpeg", quality=95)
    other = np.asarray(Image.open(io.BytesIO(stream.getvalue()))).astype(int)
    assert np.abs(decoded(stream.getvalue()).astype(int) - other).max() <= 1  # two versions of the inverse transform
