"""Masks as PNG files and as text in the settings."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from semlive.errors import BadInput
from semlive.inputs.mask_file import MASK_PREFIX, MAX_MASK_BYTES, embedded_mask, mask_bytes, mask_text, read_mask


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def drawn(width: int = 8, height: int = 6) -> np.ndarray:
    image = np.full((height, width), 255, dtype=np.uint8)
    image[1:3, 2:5] = 0
    return image


def test_a_mask_is_the_same_file_after_embedding() -> None:
    data = png(drawn())
    text = embedded_mask(data, "mask.png")
    assert mask_bytes(text) == data
    assert np.array_equal(read_mask(text), drawn() > 0)


@pytest.mark.parametrize("kind", [np.uint16(7), np.uint8(1)])
def test_every_grey_level_above_zero_may_be_used(kind: np.generic) -> None:
    image = (drawn() > 0).astype(kind.dtype) * kind
    assert np.array_equal(read_mask(embedded_mask(png(image), "mask.png")), drawn() > 0)


def test_a_mask_cannot_be_changed_by_a_reader() -> None:
    with pytest.raises(ValueError, match="read-only"):
        read_mask(embedded_mask(png(drawn()), "mask.png"))[0, 0] = False


def test_the_text_of_a_mask_names_size_part_and_checksum() -> None:
    assert mask_text(embedded_mask(png(drawn()), "mask.png")).startswith("PNG of 8 x 6 px, 12 % excluded, SHA-256 ")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "is no PNG file"),
        (b"BM" + bytes(60), "is no PNG file"),
        (png(drawn())[:40], "is damaged"),
        (png(np.zeros((6, 8), dtype=np.uint8)), "excludes every pixel"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (2**16).to_bytes(4, "big") * 2 + bytes(20), "larger than any frame"),
        (bytes(MAX_MASK_BYTES + 1), "more than 2097152"),
    ],
)
def test_a_file_that_is_no_mask_is_refused_by_name(data: bytes, reason: str) -> None:
    with pytest.raises(BadInput, match=reason) as error:
        embedded_mask(data, "strip.png")
    assert str(error.value).startswith("strip.png: ")


@pytest.mark.parametrize("text", ["mask.png", MASK_PREFIX + "?"])
def test_text_that_is_no_embedded_mask_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match=r"dic\.mask"):
        read_mask(text)
