"""Mask of a frame: a PNG file with 0 where the frame must not be used, and its bytes as text.

Settings contain the bytes as text, so that the log of a run contains its mask bit by bit.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import struct
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from semlive.errors import BadInput

MASK_PREFIX = "data:image/png;base64,"
"""Beginning of a mask whose bytes are embedded."""
MAX_MASK_BYTES = 2**21
"""Size of the file; polygons in a frame of 16384 px take less than 1 MB."""
_MAX_PIXELS = 2**29
_PNG_HEAD = struct.Struct(">8sI4sII")
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

Mask = NDArray[np.bool_]


def embedded_mask(data: bytes, name: str) -> str:
    """Return a mask file as the text of `DicSettings.mask`.

    Args:
        data: bytes of a PNG file: 0 where the frame must not be used.
        name: name of the file, with which error messages begin.

    Raises:
        BadInput: it is no PNG file, is too large, or its image cannot be decoded.
    """
    if len(data) > MAX_MASK_BYTES:
        raise BadInput(f"{name}: the mask has {len(data)} bytes, more than {MAX_MASK_BYTES}; write it as PNG with two grey levels")
    _decoded(data, name)
    return MASK_PREFIX + base64.b64encode(data).decode("ascii")


@lru_cache(maxsize=2)
def read_mask(text: str) -> Mask:
    """Return an embedded mask as a read-only array (height, width), True where a frame may be used.

    Raises:
        BadInput: the mask is not embedded, or cannot be decoded.
    """
    return _decoded(mask_bytes(text), "dic.mask")


def mask_bytes(text: str) -> bytes:
    """Return the PNG file of an embedded mask.

    Raises:
        BadInput: the mask is not embedded, or its text is damaged.
    """
    if not text.startswith(MASK_PREFIX):
        raise BadInput(f"dic.mask {text[:80]}: the mask is not embedded in the settings; give a configuration file that names a PNG file")
    try:
        return base64.b64decode(text.removeprefix(MASK_PREFIX), validate=True)
    except binascii.Error:
        raise BadInput("dic.mask: its bytes are not base64; recover the log, or draw the mask again") from None


def mask_text(text: str) -> str:
    """Return a description of an embedded mask: size, excluded part and checksum."""
    if not text.startswith(MASK_PREFIX):
        return text
    mask = read_mask(text)
    digest = hashlib.sha256(mask_bytes(text)).hexdigest()
    height, width = mask.shape
    return f"PNG of {width} x {height} px, {100.0 * (1.0 - float(mask.mean())):.2g} % excluded, SHA-256 {digest}"


def _decoded(data: bytes, name: str) -> Mask:
    """Decode a PNG file, whose size is verified before."""
    import cv2  # noqa: PLC0415  (few runs have a mask, and the control process needs OpenCV for nothing else)

    if len(data) < _PNG_HEAD.size or not data.startswith(_PNG_SIGNATURE):
        raise BadInput(f"{name}: is no PNG file; write the mask as PNG, 0 where the frame must not be used")
    _, _, _, width, height = _PNG_HEAD.unpack_from(data)
    if not 0 < width * height <= _MAX_PIXELS:
        raise BadInput(f"{name}: a mask of {width} x {height} px is larger than any frame; draw it on a frame of the run")
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if image is None or image.shape != (height, width):
        raise BadInput(f"{name}: the PNG file is damaged; write the mask again")
    mask = np.asarray(image > 0)
    if not mask.any():
        raise BadInput(f"{name}: the mask excludes every pixel; it must be 0 only where the frame must not be used")
    mask.flags.writeable = False
    return mask
