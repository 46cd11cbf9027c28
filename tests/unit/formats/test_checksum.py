"""The log's checksum is the one that every MCAP reader computes, whichever library is at hand."""

from __future__ import annotations

import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.formats.metadata.checksum import crc32


def test_it_is_the_one_of_the_standard() -> None:
    assert crc32(b"123456789") == 0xCBF43926


@given(data=st.binary(max_size=5000), before=st.integers(0, 2**32 - 1))
def test_it_is_zlibs_also_for_a_continued_checksum(data: bytes, before: int) -> None:
    assert crc32(data) == zlib.crc32(data)
    assert crc32(data, before) == zlib.crc32(data, before)


@pytest.mark.parametrize("size", [1 << 20, (1 << 20) + 13])
def test_of_an_image_too(size: int) -> None:
    image = bytes(number * 7 % 251 for number in range(size))
    assert crc32(memoryview(image)[5:]) == zlib.crc32(image[5:])
