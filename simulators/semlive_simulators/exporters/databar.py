"""The databar below an image, or over its last rows: instrument settings as text, and a scale bar."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive_simulators.exporters.image_metadata import ImageMetadata, Pixels


def databar(facts: ImageMetadata, rows: int) -> NDArray[np.uint8]:
    """The databar, (rows, width): instrument settings as text, and a scale bar."""
    scan = facts.scan
    bar = np.full((rows, scan.width_px), 12, dtype=np.uint8)
    if rows < 16:
        return bar
    bar[1, :] = bar[-2, :] = 200
    size = min(rows / 110.0, scan.width_px / 1900.0)
    field_mm = scan.width_px * scan.pixel_size_um * 1e-3
    texts = (
        "30.00 kV",
        f"HFW {field_mm:.2f} mm",
        "BSED",
        f"dwell {scan.dwell_time_s * 1e6:g} us",
        f"{facts.end_time:%m/%d/%Y %I:%M:%S %p}",
    )
    for column, text in zip((0.01, 0.12, 0.27, 0.35, 0.50), texts, strict=True):
        position = (round(column * scan.width_px), round(0.62 * rows))
        cv2.putText(bar, text, position, cv2.FONT_HERSHEY_SIMPLEX, size, 220, 1, cv2.LINE_AA)
    length = round(0.2 * scan.width_px)
    start = round(0.78 * scan.width_px)
    bar[rows // 2 - 1 : rows // 2 + 1, start : start + length] = 220
    bar[rows // 3 : 2 * rows // 3, (start, start + length)] = 220
    return bar


def appended(image: Pixels, facts: ImageMetadata, rows: int) -> Pixels:
    """The image with a databar of a number of rows below it."""
    return np.concatenate([image, _in_depth_of(databar(facts, rows), image)]) if rows else image


def burnt_in(image: Pixels, facts: ImageMetadata, rows: int) -> Pixels:
    """The image with a databar instead of its last rows."""
    return np.concatenate([image[:-rows], _in_depth_of(databar(facts, rows), image)]) if rows else image


def _in_depth_of(bar: NDArray[np.uint8], image: Pixels) -> Pixels:
    return bar if image.dtype == np.uint8 else bar.astype(np.uint16) * np.uint16(257)
