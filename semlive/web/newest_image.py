"""The newest exported file as an image for browsers, and the mask of the run."""

from __future__ import annotations

import cv2

from semlive.data.frame import ExportedFile
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadInput
from semlive.formats import read_frame
from semlive.formats.log.messages import FileMessage, RunMessage, from_json
from semlive.inputs.mask_file import Mask, read_mask
from semlive.service.log.settings import settings_of
from semlive.web.broadcaster import LogBroadcaster
from semlive.web.frame_images import browser_png


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
    image = read_frame(file, _settings(hub).scan).image
    height, width = image.shape
    try:
        return browser_png(image), (width, height)
    except cv2.error as error:
        raise BadInput(f"{metadata.name}: the image cannot be encoded as PNG") from error


def run_mask(hub: LogBroadcaster) -> Mask | None:
    """Return the mask of the run; None without one."""
    settings = _settings(hub)
    return None if settings.dic.mask is None else read_mask(settings.dic.mask)


def _settings(hub: LogBroadcaster) -> AnalysisSettings:
    """Return the settings of the configuration of the run; the defaults if it cannot be read."""
    message = None if hub.run_message is None else from_json(hub.run_message.topic, hub.run_message.payload)
    try:
        return settings_of(message) if isinstance(message, RunMessage) else AnalysisSettings()
    except BadInput:
        return AnalysisSettings()
