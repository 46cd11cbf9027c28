"""Images of frames for the page: from the log, reduced where they are large, and the mask as a picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from semlive.errors import BadLog
from semlive.formats.log.foxglove import SEM_IMAGE, compressed_image, read_compressed_image
from semlive.formats.log.reader import LogMessage
from semlive.web.frame_images import FrameImageStore, mask_png


def message(image: np.ndarray, name: str = "frame 7", topic: str = SEM_IMAGE) -> LogMessage:
    return LogMessage(topic, 1, 1, 0, compressed_image(image, 1, name))


def decoded(png: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def read(store: FrameImageStore, frame: int) -> tuple[bytes, tuple[int, int]]:
    found = store.read(frame)
    assert found is not None
    return found


def test_a_frame_is_read_as_it_was_written() -> None:
    image, store = np.random.default_rng(1).integers(0, 256, (30, 40), dtype=np.uint8), FrameImageStore()
    assert store.take(message(image)) == 7
    assert store.take(message(image[:, ::-1], "frame 8")) == 8
    png, size = read(store, 7)
    assert size == (40, 30)
    assert np.array_equal(decoded(png), image)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_large_frame_is_reduced_and_keeps_its_size_in_the_log(kind: type) -> None:
    store = FrameImageStore()
    store.take(message(np.full((1200, 1600), 200, dtype=kind)))
    png, size = read(store, 7)
    assert size == (1600, 1200)
    assert decoded(png).shape == (768, 1024)
    assert decoded(png).dtype == np.uint8


def test_other_messages_have_no_image() -> None:
    store = FrameImageStore()
    assert store.take(message(np.zeros((4, 4), np.uint8), topic="/strain/image/exx")) is None
    assert store.take(message(np.zeros((4, 4), np.uint8), "revision 3")) is None
    assert store.read(7) is None


@pytest.mark.parametrize("cut", [1, 40])
def test_a_truncated_image_is_an_error_of_the_log(cut: int) -> None:
    payload = compressed_image(np.zeros((30, 40), np.uint8), 1, "frame 7")
    with pytest.raises(BadLog, match="truncated"):
        read_compressed_image(payload[:-cut])


def test_a_mask_is_opaque_only_where_frames_are_not_used() -> None:
    mask = np.ones((60, 80), dtype=bool)
    mask[10:20, 30:50] = False
    alpha = decoded(mask_png(mask))[..., 3]
    assert np.array_equal(alpha > 0, ~mask)
