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
    """The file as PNG without its databar, no edge longer than 1024 px, and its own size (width, height); None if it is not the newest.

    Raises:
        BadInput: it cannot be read; the sentence says why.
    """
    original, told = hub.original, hub.file_message
    if original is None or told is None or original.export != export:
        return None
    about = from_json(told.topic, told.payload)
    if not isinstance(about, FileMessage) or about.export != export:
        return None
    file = ExportedFile(export, about.name, original.data, about.sha256, about.mtime_ns, about.arrival_time_ns, original.sidecar)
    image = read_frame(file, _profile(hub)).image
    height, width = image.shape
    if image.dtype != np.uint8:
        image = cv2.convertScaleAbs(image, alpha=255.0 / max(1, int(image.max())))
    smaller = _MAX_EDGE_PX / max(width, height)
    if smaller < 1.0:
        image = cv2.resize(image, None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA)
    done, png = cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 1))
    if not done:
        raise BadInput(f"{about.name}: cannot be shown")
    return png.tobytes(), (width, height)


def _profile(hub: LogBroadcaster) -> ScanProfile:
    """Return the file settings of the configuration of the run."""
    if hub.run_message is None:
        return ScanProfile()
    told = from_json(hub.run_message.topic, hub.run_message.payload)
    try:
        return (
            parse_config(told.config, "the run's configuration").analysis_settings().scan if isinstance(told, RunMessage) else ScanProfile()
        )
    except BadInput:
        return ScanProfile()
