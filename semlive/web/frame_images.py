"""Images of analysed frames for the browser, from the preview images in the log; stored in a temporary file."""

from __future__ import annotations

import struct
import tempfile
import threading
import weakref
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.formats.log.foxglove import SEM_IMAGE, read_compressed_image
from semlive.formats.log.reader import LogMessage

MAX_EDGE_PX = 1024
"""Longest edge of an image on the page; a larger one is reduced by averaging."""
_PNG_HEAD = struct.Struct(">8sI4sIIB")


class FrameImageStore:
    """Images of the analysed frames, at most 1024 px wide, in a temporary file that is removed with the process."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(prefix="semlive-page-")  # noqa: SIM115 - as long as the store
        weakref.finalize(self, self._file.close)
        self._places: dict[int, tuple[int, int, tuple[int, int]]] = {}
        self._lock = threading.Lock()

    def take(self, message: LogMessage) -> int | None:
        """Store the image in a message and return the number of its frame; None if the message has no image of a frame.

        Raises:
            BadLog: the bytes are not a preview image.
        """
        if message.topic != SEM_IMAGE:
            return None
        png, name = read_compressed_image(message.payload)
        number = name.removeprefix("frame ")
        if not number.isdecimal() or len(png) < _PNG_HEAD.size:
            return None
        _, _, _, width, height, bits = _PNG_HEAD.unpack_from(png)
        if bits != 8 or max(width, height) > MAX_EDGE_PX:
            image = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
            if image is None:
                return None
            png = browser_png(np.asarray(image))
        with self._lock:
            begin = self._file.seek(0, 2)
            self._file.write(png)
            self._places[int(number)] = (begin, len(png), (width, height))
        return int(number)

    def read(self, frame: int) -> tuple[bytes, tuple[int, int]] | None:
        """Return the PNG of a frame and its (width, height) in the log, px; None if there is none."""
        with self._lock:
            place = self._places.get(frame)
            if place is None:
                return None
            self._file.seek(place[0])
            return self._file.read(place[1]), place[2]


def browser_png(image: NDArray[Any]) -> bytes:
    """Return an image of grey levels as a PNG of 8 bit, no edge longer than `MAX_EDGE_PX`.

    Args:
        image: (height, width) uint8 or uint16.

    Raises:
        cv2.error: the image cannot be encoded.
    """
    shown = image if image.dtype == np.uint8 else cv2.convertScaleAbs(image, alpha=255.0 / max(1, int(image.max())))
    smaller = MAX_EDGE_PX / max(image.shape)
    if smaller < 1.0:
        shown = cv2.resize(shown, None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".png", shown, (cv2.IMWRITE_PNG_COMPRESSION, 1))[1].tobytes()


def mask_png(mask: NDArray[np.bool_]) -> bytes:
    """Return a mask as a PNG to be laid over an image: stripes where a frame is not used, transparent elsewhere.

    Args:
        mask: (height, width) True where a frame may be used.
    """
    smaller = min(1.0, MAX_EDGE_PX / max(mask.shape))
    excluded = cv2.resize((~mask).astype(np.uint8), None, fx=smaller, fy=smaller, interpolation=cv2.INTER_NEAREST) > 0
    y, x = np.indices(excluded.shape)
    dark = (x + y) // 6 % 2 == 0
    picture = np.zeros((*excluded.shape, 4), dtype=np.uint8)
    picture[excluded & dark] = (0, 0, 0, 170)
    picture[excluded & ~dark] = (255, 255, 255, 110)
    return cv2.imencode(".png", picture, (cv2.IMWRITE_PNG_COMPRESSION, 6))[1].tobytes()
