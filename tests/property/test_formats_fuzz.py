"""Damaged files: nothing but BadImage comes out, and it comes soon."""

from __future__ import annotations

import time
from io import BytesIO

import cv2
import numpy as np
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats import check_complete, read_frame
from semlive.formats.vendors.fei import parse_ini, parse_xml

SOON_S = 2.0
PROFILE = ScanProfile(dwell_time_s=1e-5, row_time_s=1e-2, pixel_size_m=1e-8)
IMAGE = np.random.default_rng(0).integers(0, 255, (24, 32), dtype=np.uint8)
INI = (
    "[User]\nDate=11/10/2023\nTime=02:09:15 PM\n[EScan]\nDwell=1e-5\nLineTime=0.001\nFrameTime=0.03\nPixelWidth=1e-8\n"
    "[Image]\nResolutionX=32\nResolutionY=20\nIntegrate=1\n"
)
XML = "<Metadata><Acquisition><AcquisitionDatetime>2023-11-10T14:09:15.5</AcquisitionDatetime></Acquisition></Metadata>"


def _tiff(**options: object) -> bytes:
    stream = BytesIO()
    tags = [(34682, 2, 0, INI, True), (34683, 2, 0, XML, True)]
    tifffile.imwrite(stream, IMAGE, extratags=tags, metadata=None, **options)  # type: ignore[arg-type]
    return stream.getvalue()


SEEDS = (
    _tiff(rowsperstrip=1),
    _tiff(byteorder=">"),
    _tiff(bigtiff=True),
    cv2.imencode(".tif", IMAGE)[1].tobytes(),  # LZW
    cv2.imencode(".png", IMAGE)[1].tobytes(),
)


def _mutate(seed: bytes, end: int, edits: list[tuple[int, bytes]]) -> bytes:
    data = bytearray(seed)
    for at, new in edits:
        at %= len(data)
        data[at : at + len(new)] = new
    return bytes(data[: len(data) - end % len(data)])


EDITS = st.lists(
    st.tuples(
        st.integers(0, 2**16),
        st.one_of(st.binary(min_size=1, max_size=8), st.sampled_from([b"\xff" * 4, b"\0" * 4, b"\xff" * 8, b"\0\0\0\x80"])),
    ),
    max_size=6,
)


def _read(data: bytes) -> None:
    began_s = time.process_time()
    check_complete(data)
    sentence = None
    try:
        frame = read_frame(ExportedFile(0, "x.tif", data, "", 10**18, 10**18), PROFILE)
    except BadImage as exc:
        sentence = str(exc)
    else:
        assert frame.image.dtype in (np.uint8, np.uint16)
    assert sentence is None or ("x.tif" in sentence and "\n" not in sentence)
    assert time.process_time() - began_s < SOON_S


@settings(max_examples=400)
@given(st.sampled_from(SEEDS), st.one_of(st.just(0), st.integers(0, 2**16)), EDITS)
def test_damaged_files_raise_nothing_but_bad_image(seed: bytes, end: int, edits: list[tuple[int, bytes]]) -> None:
    _read(_mutate(seed, end, edits))


@settings(max_examples=100)
@given(st.sampled_from([b"", b"II*\0", b"MM\0*", b"II+\0", b"\x89PNG\r\n\x1a\n"]), st.binary(max_size=200))
def test_anything_raises_nothing_but_bad_image(head: bytes, rest: bytes) -> None:
    _read(head + rest)


def test_a_chunk_that_declares_a_gigabyte_takes_no_memory() -> None:
    # This once made the decoder take 1.2 GB and 4 s; found by mutation.
    png = bytearray(SEEDS[-1])
    png[-12:-8] = b"\x45\0\0\0"
    assert check_complete(bytes(png)) is not None
    _read(bytes(png))


@settings(max_examples=100)
@given(st.text(max_size=300))
def test_headers_of_any_text_are_parsed_or_passed_over(text: str) -> None:
    parse_ini(text)
    parse_xml(text)
    parse_xml(f"<a>{text}</a>")
