"""TIFF and PNG files without metadata."""

from __future__ import annotations

import cv2

from semlive_simulators.exporters import databar, tiff
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels


def tiff_bytes(pixels: Pixels) -> bytes:
    """A TIFF with the required tags only."""
    height, width = pixels.shape
    entries = [
        tiff.shorts(256, width),
        tiff.shorts(257, height),
        tiff.shorts(258, 8 * pixels.itemsize),
        tiff.shorts(259, 1),
        tiff.shorts(262, 1),
        tiff.shorts(277, 1),
        tiff.shorts(278, height),
    ]
    return tiff.file_bytes(tiff.row_strips(pixels, height), entries, directory_first=False)


def encode_tiff(image: Pixels, facts: ImageMetadata, databar_rows: int) -> EncodedFrame:
    """A frame as TIFF."""
    return EncodedFrame(tiff_bytes(databar.appended(image, facts, databar_rows)))


def encode_png(image: Pixels, facts: ImageMetadata, databar_rows: int) -> EncodedFrame:
    """A frame as PNG."""
    _, encoded = cv2.imencode(".png", databar.appended(image, facts, databar_rows))
    return EncodedFrame(encoded.tobytes())
