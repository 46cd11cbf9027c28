"""Rules for TIFF files beyond plain grey: several images, grey scales, and files that would exhaust the memory."""

from __future__ import annotations

import io
import re
import struct
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats import check_complete, check_finished, read_frame
from semlive.formats.images.image_files import read_picture
from semlive.formats.images.inspection import inspect_file
from semlive_simulators.exporters import tiff as writer

PROFILE = ScanProfile(dwell_time_s=1e-6, row_time_s=1e-3, pixel_size_m=1e-8, databar_rows=0)


def speckle(seed: int = 0, shape: tuple[int, int] = (48, 64)) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def pages(*images: tuple[NDArray[np.generic], dict[str, object]]) -> bytes:
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as file:
        for image, settings in images:
            file.write(image, **{"metadata": None, "photometric": "minisblack", **settings})
    return stream.getvalue()


def exported(data: bytes) -> ExportedFile:
    return ExportedFile(0, "a.tif", data, "", 1, 1)


def grey(data: bytes, profile: ScanProfile = PROFILE) -> NDArray[np.generic]:
    return read_frame(exported(data), profile).image


def test_of_several_frames_the_user_chooses_one() -> None:
    data = pages((speckle(1), {}), (speckle(2), {}), (speckle(3, (20, 60)), {}))
    with pytest.raises(BadImage, match=r"image 1 of 3 \(64 x 48 px\), image 2 of 3 .*image 3 of 3 \(60 x 20 px\)\).*sem\.profile\.page"):
        grey(data)
    assert check_complete(data) is None
    assert check_finished(exported(data), PROFILE) is None  # complete: the watcher passes it on, and the reader states the cause
    assert np.array_equal(grey(data, replace(PROFILE, page=2)), speckle(2))
    assert np.array_equal(read_picture(data, "a.tif", 3), speckle(3, (20, 60)))
    with pytest.raises(BadImage, match="has 3 images, not an image 4"):
        grey(data, replace(PROFILE, page=4))
    assert "several images" in inspect_file(exported(data), PROFILE).problems[0]


@pytest.mark.parametrize("settings", [{"subfiletype": 1}, {}], ids=["marked copy", "unmarked copy"])
@pytest.mark.parametrize("copy_first", [False, True])
def test_a_thumbnail_is_not_the_frame(settings: dict[str, object], copy_first: bool) -> None:
    thumbnail = (speckle(9, (12, 16)), settings)
    data = pages(*((thumbnail, (speckle(), {})) if copy_first else ((speckle(), {}), thumbnail)))
    frame = read_frame(exported(data), PROFILE)
    assert np.array_equal(frame.image, speckle())
    assert any("16 x 12 px" in note for note in frame.info.notes)


@pytest.mark.parametrize("shape", [(48, 64), (49, 65)])
def test_half_the_size_of_the_frame_is_a_thumbnail_also_if_it_was_rounded_up(shape: tuple[int, int]) -> None:
    assert np.array_equal(grey(pages((speckle(1, (-(-shape[0] // 2), -(-shape[1] // 2))), {}), (speckle(2, shape), {}))), speckle(2, shape))


@pytest.mark.parametrize("big", [False, True])
def test_a_thumbnail_with_its_image_below_it_is_refused(big: bool) -> None:
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream, bigtiff=big) as file:
        file.write(speckle(9, (12, 16)), subifds=1, subfiletype=1, metadata=None)
        file.write(speckle(), metadata=None)
    with pytest.raises(BadImage, match=r"thumbnail of 16 x 12 px with an image of 64 x 48 px below it"):
        grey(stream.getvalue())
    assert "thumbnail" in inspect_file(exported(stream.getvalue()), PROFILE).problems[0]


def test_a_mask_of_the_same_size_is_not_the_frame() -> None:
    assert np.array_equal(grey(patched(pages((speckle(9), {"subfiletype": 1}), (speckle(), {})), 254, 4)), speckle())


def test_the_header_of_the_first_image_describes_the_chosen_one() -> None:
    ini = "[EScan]\nDwell=1e-06\nLineTime=0.001\nFrameTime=0.05\nPixelWidth=2e-08\n[User]\nDate=03/14/2022\nTime=11:52:46 AM\n"
    data = pages((speckle(9, (12, 16)), {"subfiletype": 1, "extratags": [(34682, "s", 0, ini, True)]}), (speckle(), {}))
    assert read_frame(exported(data), PROFILE).info.pixel_size_m.value == 2e-8


def test_a_stack_behind_one_directory_is_named() -> None:
    stream = io.BytesIO()
    tifffile.imwrite(stream, speckle(), metadata=None, description="ImageJ=1.54f\nimages=7\nslices=7\n")
    with pytest.raises(BadImage, match="ImageJ stack of 7 images"):
        grey(stream.getvalue())


def packed(levels: NDArray[np.uint16], photometric: int) -> bytes:
    """12 bits a sample, two samples in three bytes, the first in the high bits (TIFF 6.0, section 'BitsPerSample')."""
    bits = (levels[..., None] >> np.arange(11, -1, -1)) & 1
    rows = np.packbits(bits.reshape(len(levels), -1).astype(np.uint8), axis=1)
    entries = [
        writer.longs(256, levels.shape[1]),
        writer.longs(257, levels.shape[0]),
        writer.shorts(258, 12),
        writer.shorts(259, 1),
        writer.shorts(262, photometric),
        writer.shorts(277, 1),
        writer.longs(278, len(levels)),
    ]
    return writer.file_bytes([rows.tobytes()], entries, directory_first=True)


@pytest.mark.parametrize("photometric", [0, 1])
def test_twelve_packed_bits_keep_their_levels_and_are_inverted_at_4095(photometric: int) -> None:
    levels = np.random.default_rng(4).integers(0, 4096, (48, 65), dtype=np.uint16)
    assert np.array_equal(grey(packed(levels, photometric)), levels if photometric else 4095 - levels)


@pytest.mark.parametrize(
    ("settings", "kind", "reason"),
    [
        ({}, np.float32, "32 bit (floating point)"),
        ({}, np.float64, "64 bit (floating point)"),
        ({}, np.uint32, "32 bit (unsigned)"),
        ({}, np.complex64, "64 bit (complex)"),
        ({"photometric": "separated"}, np.uint8, "colour space 5"),
        ({"photometric": "cielab"}, np.uint8, "colour space 8"),
        ({"compression": "jpeg2000"}, np.uint8, "compressed by method"),
    ],
)
def test_pixels_of_other_kinds_are_refused_by_name(settings: dict[str, object], kind: type[np.generic], reason: str) -> None:
    samples = {"separated": 4, "cielab": 3}.get(str(settings.get("photometric")), 1)
    image = np.stack([speckle()] * samples, axis=2) if samples > 1 else speckle().astype(kind)
    with pytest.raises(BadImage, match=re.escape(reason)):
        grey(pages((image, settings)))


def test_two_signals_are_refused_and_transparency_is_dropped() -> None:
    both = np.stack([speckle(1), speckle(2)], axis=2)
    with pytest.raises(BadImage, match="2 signals"):
        grey(pages((both, {"planarconfig": "contig", "extrasamples": ["unspecified"]})))
    assert np.array_equal(grey(pages((both, {"planarconfig": "contig", "extrasamples": ["unassalpha"]}))), speckle(1))


def with_palette(red: NDArray[np.integer], green: NDArray[np.integer], blue: NDArray[np.integer]) -> bytes:
    colours = writer.shorts(320, *(int(level) for band in (red, green, blue) for level in band))
    entries = [writer.shorts(262, 3) if entry[0] == 262 else entry for entry in plain_entries(compression=1)]
    return writer.file_bytes([speckle().tobytes()], [*entries, colours], directory_first=True)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("white", [255, 65535])
def test_a_grey_palette_is_applied(turned: bool, white: int) -> None:
    ramp = np.arange(256) * (white // 255)
    data = with_palette(*[ramp[::-1] if turned else ramp] * 3)
    assert np.array_equal(grey(data), 255 - speckle() if turned else speckle())
    if white > 255:
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(data)).convert("L")), grey(data))


def test_entries_of_a_ramp_that_are_annotation_change_no_grey_level() -> None:
    red, green, blue = (np.arange(256) * 257 for _ in range(3))
    red[9], green[9], blue[9] = 65535, 0, 0  # as in a file of a Zeiss Ultra 55
    red[21] = green[21] = blue[21] = 65535
    assert np.array_equal(grey(with_palette(red, green, blue)), speckle())


def plain_entries(compression: int) -> list[writer.Entry]:
    size = [writer.longs(256, 64), writer.longs(257, 48), writer.shorts(258, 8), writer.shorts(259, compression)]
    return [*size, writer.shorts(262, 1), writer.shorts(277, 1), writer.longs(278, 48)]


def test_false_colours_are_refused() -> None:
    colours = np.random.default_rng(0).integers(0, 65536, (3, 256), dtype=np.uint16)
    with pytest.raises(BadImage, match="false colours"):
        grey(pages((speckle(), {"photometric": "palette", "colormap": colours})))


def test_a_predictor_without_compression_is_refused() -> None:
    with pytest.raises(BadImage, match="predictor but no compression"):
        grey(writer.file_bytes([speckle().tobytes()], [*plain_entries(compression=1), writer.shorts(317, 2)], directory_first=True))


def peak_bytes(data: bytes) -> int:
    tracemalloc.start()
    try:
        with pytest.raises(BadImage):
            grey(data)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def patched(data: bytes, tag: int, value: int) -> bytes:
    """The file with another value of a 32-bit or 16-bit tag."""
    changed, (at,) = bytearray(data), struct.unpack_from("<I", data, 4)
    for entry in range(at + 2, at + 2 + 12 * struct.unpack_from("<H", data, at)[0], 12):
        if struct.unpack_from("<H", data, entry)[0] == tag:
            struct.pack_into("<HII", changed, entry + 2, 4, 1, value)
    return bytes(changed)


@pytest.mark.parametrize("side_px", [20_001, 16_000])
def test_a_small_file_of_a_large_image_takes_no_memory(side_px: int) -> None:
    data = pages((speckle(), {"compression": "zlib", "rowsperstrip": 48}))
    assert peak_bytes(patched(patched(data, 256, side_px), 257, side_px)) < 2**20


def test_a_strip_that_expands_beyond_its_place_takes_the_memory_of_its_place() -> None:
    bomb = zlib.compress(bytes(50 * 2**20), 9)
    assert peak_bytes(writer.file_bytes([bomb], plain_entries(compression=8), directory_first=True)) < 2**20


def test_tiles_far_larger_than_the_image_are_refused() -> None:
    data = pages((speckle(), {"compression": "zlib", "tile": (16, 16)}))
    assert peak_bytes(patched(patched(data, 322, 16_000), 323, 16_000)) < 2**20


def test_a_jpeg_strip_of_a_larger_image_is_refused() -> None:
    stream = io.BytesIO()
    Image.fromarray(speckle()).save(stream, "TIFF", compression="jpeg")
    data = bytearray(stream.getvalue())
    data[(at := data.index(b"\xff\xc0")) + 5 : at + 9] = struct.pack(">HH", 60_000, 60_000)
    assert peak_bytes(bytes(data)) < 2**20


def test_one_strip_may_state_more_rows_than_the_image_has() -> None:
    data = pages((speckle(), {"compression": "lzw", "rowsperstrip": 48}))
    assert np.array_equal(grey(patched(data, 278, 2**32 - 1)), speckle())


def test_strips_that_are_not_written_are_missing() -> None:
    data = pages((speckle(), {"rowsperstrip": 48}))
    assert "1 of its 1 strips or tiles are not written" in str(check_complete(patched(data, 279, 0)))
