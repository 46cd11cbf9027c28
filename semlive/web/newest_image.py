"""The newest exported file as an image for browsers."""

from __future__ import annotations

import cv2
import numpy as np

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadInput
from semlive.formats import read_frame
from semlive.formats.log.messages import FileMessage, RunMessage, from_json
from semlive.service.config.configuration import parse_config
from semlive.web.broadcaster import LogBroadcaster

_MAX_EDGE_PX = 1024


def newest_image_png(hub: LogBroadcaster, export: int) -> tuple[bytes, tuple[int, int]] | None:
    """Return the newest file as PNG without its databar, no edge longer than 1024 px, and the (width, height) of the file, px.

    Args:
        hub: reader of the log.
        export: number of the file; the result is None if it is not the newest.

    Raises:
        BadInput: the file cannot be read; the message gives the reason.
    """
    original, file_message = hub.original, hub.file_message
    if original is None or file_message is None or original.export != export:
        return None
    metadata = from_json(file_message.topic, file_message.payload)
    if not isinstance(metadata, FileMessage) or metadata.export != export:
        return None
    file = ExportedFile(
        export, metadata.name, original.data, metadata.sha256, metadata.mtime_ns, metadata.arrival_time_ns, original.sidecar
    )
    image = read_frame(file, _profile(hub)).image
    height, width = image.shape
    if image.dtype != np.uint8:
        image = cv2.convertScaleAbs(image, alpha=255.0 / max(1, int(image.max())))
    smaller = _MAX_EDGE_PX / max(width, height)
    if smaller < 1.0:
        image = cv2.resize(image, None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA)
    encoded, png = cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 1))
    if not encoded:
        raise BadInput(f"{metadata.name}: the image cannot be encoded as PNG")
    return png.tobytes(), (width, height)


def _profile(hub: LogBroadcaster) -> ScanProfile:
    """Return the file settings of the configuration of the run."""
    if hub.run_message is None:
        return ScanProfile()
    message = from_json(hub.run_message.topic, hub.run_message.payload)
    try:
        return (
            parse_config(message.config, "the run's configuration").analysis_settings().scan
            if isinstance(message, RunMessage)
            else ScanProfile()
        )
    except BadInput:
        return ScanProfile()
