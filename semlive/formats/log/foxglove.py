"""Images in two protobuf messages of Foxglove, which it shows without a plug-in; this module encodes and reads them.

Six numbers, a string and some bytes need no protobuf library. The schemas below are those of foxglove-sdk 0.30 (a set of file
descriptors, base64), and a test decodes the output of this module with that library. The library has 19 MB of compiled code, of which
semlive would use two functions.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadLog

SEM_IMAGE = "/sem/image"
"""An analysed frame without databar, lossless; `sequence` is the number of its export."""
COMPRESSED_IMAGE = "foxglove.CompressedImage"
RAW_IMAGE = "foxglove.RawImage"
FIELD_IMAGE_TOPICS: Mapping[str, tuple[str, ...]] = {
    "/dic/image": ("u", "v"),
    "/dic/pair_image": ("u", "v"),
    "/distortion/image": ("x", "y"),
    "/strain/image": ("exx", "eyy", "exy"),
}
"""Maps that are shown, and their components; each component is a separate topic."""
IMAGE_TOPICS: Mapping[str, str] = {
    SEM_IMAGE: COMPRESSED_IMAGE,
    **{f"{topic}/{component}": RAW_IMAGE for topic, components in FIELD_IMAGE_TOPICS.items() for component in components},
}
"""Topics with images, and the schema of each."""


_COMPRESSED_IMAGE = (
    "Cv8BCh9nb29nbGUvcHJvdG9idWYvdGltZXN0YW1wLnByb3RvEg9nb29nbGUucHJvdG9idWYiOwoJVGltZXN0YW1wEhgKB3NlY29uZHMYASABKANSB3NlY29u"
    "ZHMSFAoFbmFub3MYAiABKAVSBW5hbm9zQoUBChNjb20uZ29vZ2xlLnByb3RvYnVmQg5UaW1lc3RhbXBQcm90b1ABWjJnb29nbGUuZ29sYW5nLm9yZy9wcm90"
    "b2J1Zi90eXBlcy9rbm93bi90aW1lc3RhbXBwYvgBAaICA0dQQqoCHkdvb2dsZS5Qcm90b2J1Zi5XZWxsS25vd25UeXBlc2IGcHJvdG8zCugBCh5mb3hnbG92"
    "ZS9Db21wcmVzc2VkSW1hZ2UucHJvdG8SCGZveGdsb3ZlGh9nb29nbGUvcHJvdG9idWYvdGltZXN0YW1wLnByb3RvIpIBCg9Db21wcmVzc2VkSW1hZ2USOAoJ"
    "dGltZXN0YW1wGAEgASgLMhouZ29vZ2xlLnByb3RvYnVmLlRpbWVzdGFtcFIJdGltZXN0YW1wEhkKCGZyYW1lX2lkGAQgASgJUgdmcmFtZUlkEhIKBGRhdGEY"
    "AiABKAxSBGRhdGESFgoGZm9ybWF0GAMgASgJUgZmb3JtYXRiBnByb3RvMw=="
)
_RAW_IMAGE = (
    "Cv8BCh9nb29nbGUvcHJvdG9idWYvdGltZXN0YW1wLnByb3RvEg9nb29nbGUucHJvdG9idWYiOwoJVGltZXN0YW1wEhgKB3NlY29uZHMYASABKANSB3NlY29u"
    "ZHMSFAoFbmFub3MYAiABKAVSBW5hbm9zQoUBChNjb20uZ29vZ2xlLnByb3RvYnVmQg5UaW1lc3RhbXBQcm90b1ABWjJnb29nbGUuZ29sYW5nLm9yZy9wcm90"
    "b2J1Zi90eXBlcy9rbm93bi90aW1lc3RhbXBwYvgBAaICA0dQQqoCHkdvb2dsZS5Qcm90b2J1Zi5XZWxsS25vd25UeXBlc2IGcHJvdG8zCqACChdmb3hnbG92"
    "ZS9SYXdJbWFnZS5wcm90bxIIZm94Z2xvdmUaH2dvb2dsZS9wcm90b2J1Zi90aW1lc3RhbXAucHJvdG8i0QEKCFJhd0ltYWdlEjgKCXRpbWVzdGFtcBgBIAEo"
    "CzIaLmdvb2dsZS5wcm90b2J1Zi5UaW1lc3RhbXBSCXRpbWVzdGFtcBIZCghmcmFtZV9pZBgHIAEoCVIHZnJhbWVJZBIUCgV3aWR0aBgCIAEoB1IFd2lkdGgS"
    "FgoGaGVpZ2h0GAMgASgHUgZoZWlnaHQSGgoIZW5jb2RpbmcYBCABKAlSCGVuY29kaW5nEhIKBHN0ZXAYBSABKAdSBHN0ZXASEgoEZGF0YRgGIAEoDFIEZGF0"
    "YWIGcHJvdG8z"
)
FILE_DESCRIPTORS: Mapping[str, bytes] = {
    COMPRESSED_IMAGE: base64.b64decode(_COMPRESSED_IMAGE),
    RAW_IMAGE: base64.b64decode(_RAW_IMAGE),
}
"""Schemas in the binary format of protobuf, which MCAP requires."""


def compressed_image(image: NDArray[np.uint8] | NDArray[np.uint16], time_ns: int, frame_id: str) -> bytes:
    """Return an image of grey levels as a `foxglove.CompressedImage`: PNG, lossless.

    Args:
        image: (height, width).
        time_ns: experiment time, UTC ns.
        frame_id: name of the content.
    """
    import cv2  # noqa: PLC0415  (the control process writes logs and encodes no image)

    # Speckle contains no repetitions: Huffman coding of the grey levels alone gives 669 kB in 15 ms for a frame of 1024 x 884 px, the usual
    # search for repetitions 699 kB in 27 ms at level 1 and 682 kB in 33 ms at level 6.
    options = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY)
    _, png = cv2.imencode(".png", image, options)
    return b"".join((_time(1, time_ns), _bytes(2, png.tobytes()), _bytes(3, b"png"), _bytes(4, frame_id.encode())))


def read_compressed_image(payload: bytes) -> tuple[bytes, str]:
    """Return image file and name of the content of a `foxglove.CompressedImage`, as `compressed_image` writes it.

    Raises:
        BadLog: the bytes are no such message.
    """
    values, at = dict[int, bytes](), 0
    try:
        while at < len(payload):
            key, at = _read_varint(payload, at)
            if key & 7 != 2:
                raise BadLog(f"a preview image has a field of kind {key & 7}; recover the log")
            length, at = _read_varint(payload, at)
            values[key >> 3], at = payload[at : at + length], at + length
        if at > len(payload):
            raise IndexError
        return values.get(2, b""), values.get(4, b"").decode()
    except (IndexError, UnicodeDecodeError):
        raise BadLog("a preview image is truncated; recover the log") from None


def raw_image(field: NDArray[np.float64], valid: NDArray[np.bool_], time_ns: int, frame_id: str) -> bytes:
    """Return a field as a `foxglove.RawImage` of float32, one pixel for each point; NaN for invalid points.

    Args:
        field: (ny, nx).
        valid: (ny, nx), whether points are valid.
        time_ns: experiment time, UTC ns.
        frame_id: name of the content.
    """
    height, width = field.shape
    data = np.where(valid, field, np.nan).astype("<f4").tobytes()
    numbers = (_fixed32(2, width), _fixed32(3, height), _bytes(4, b"32FC1"), _fixed32(5, 4 * width))
    return b"".join((_time(1, time_ns), *numbers, _bytes(6, data), _bytes(7, frame_id.encode())))


def _varint(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    """Value of a varint, and the place after it."""
    value = shift = 0
    while data[at] & 0x80:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
    return value | data[at] << shift, at + 1


def _bytes(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(value)) + value


def _fixed32(field: int, value: int) -> bytes:
    return _varint(field << 3 | 5) + struct.pack("<I", value)


def _time(field: int, time_ns: int) -> bytes:
    seconds, nanos = divmod(max(0, time_ns), 10**9)
    return _bytes(field, _varint(1 << 3) + _varint(seconds) + _varint(2 << 3) + _varint(nanos))
