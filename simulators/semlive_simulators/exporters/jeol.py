"""JEOL: an LZW-compressed TIFF with a palette and no metadata, and a text file of ``$KEY value`` lines.

The text file contains neither dwell nor row time, only the number of a scan speed. The rows of the databar are those of the image beyond
``$CM_FULL_SIZE``; the pixel size follows from a micron bar whose length is a whole number of pixels.
"""

from __future__ import annotations

import io
import math

import cv2
import numpy as np
import tifffile

from semlive_simulators.exporters import databar, tiff
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels


def sidecar_text(facts: ImageMetadata) -> str:
    """The content of the text file."""
    scan, end = facts.scan, facts.end_time
    field_um = scan.width_px * scan.pixel_size_um
    exponent = math.floor(math.log10(0.3 * field_um))
    bar_um = max(step for step in (1, 2, 5) if step * 10.0**exponent <= 0.3 * field_um) * 10.0**exponent
    marker = f"{bar_um:g}um" if bar_um >= 1 else f"{bar_um * 1e3:g}nm"
    values = {
        "$SEM_DATA_VERSION": 1, "$CM_DATA_VERSION": 1, "$CM_SIGNAL_NAME": "BED-C", "$CM_DETECTOR_NAME": "BED-C",
        "$CM_ACCEL_VOLT": "20.00", "$$SM_WD": "10.00", "$CM_MAG": round(128_000 / field_um), "$$SM_SCAN_ROTATION": "0.00",
        "$$SM_INTEG_NO": facts.frames_integrated, "$$CM_SCAN_MODE": 2, "$$CM_SCAN_SPEED": 9, "$$CM_INSTRUMENT_SCAN_SPEED": 9,
        "$$SM_IMAGE_INTEGRATION_TYPE": 0,
        "$CM_STAGE_POS": f"{facts.stage_x_um * 1e-3:.3f} {facts.stage_y_um * 1e-3:.3f} 10.0 0.0 0.0 0.000",
        "$CM_FORMAT": "JEOL-SEM", "$CM_VERSION": "3.0", "$CM_COMMENT": "", "$CM_DATE": f"{end:%Y/%m/%d}",
        "$CM_TIME": f"{end:%H:%M:%S}", "$CM_OPERATOR": "Service", "$CM_INSTRUMENT": "SIMULATED",
        "$$SM_MICRON_BAR": round(bar_um / scan.pixel_size_um), "$$SM_MICRON_MARKER": marker, "$CM_FRAME_SIZE": "0 0",
        "$CM_TITLE": facts.name, "$CM_LABEL": "JEOL", "$CM_OFFSET": "0 0", "$CM_FULL_SIZE": f"{scan.width_px} {scan.height_px}",
        "$CM_COLOR_MODE": 0,
    }  # fmt: skip
    return "".join(f"{key} {value}\r\n" for key, value in values.items())


def _lzw(pixels: Pixels) -> bytes:
    """One strip with horizontal differences and LZW compression, from a file written by libtiff."""
    options = [cv2.IMWRITE_TIFF_COMPRESSION, 5, cv2.IMWRITE_TIFF_PREDICTOR, 2, cv2.IMWRITE_TIFF_ROWSPERSTRIP, pixels.shape[0]]
    _, encoded = cv2.imencode(".tif", pixels, options)
    data = encoded.tobytes()
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        [first], [length] = file.pages[0].dataoffsets, file.pages[0].databytecounts
    return data[first : first + length]


def encode(image: Pixels, facts: ImageMetadata, databar_rows: int) -> EncodedFrame:
    """A frame as JEOL software exports it."""
    pixels = databar.appended(image, facts, databar_rows)
    height, width = pixels.shape
    deep = pixels.dtype == np.uint16
    entries = [
        tiff.longs(254, 0),
        tiff.longs(256, width),
        tiff.longs(257, height),
        tiff.shorts(258, 8 * pixels.itemsize),
        tiff.shorts(259, 5),
        tiff.shorts(262, 1 if deep else 3),
        tiff.shorts(277, 1),
        tiff.longs(278, height),
        tiff.rational(282, 254_000, 1000),
        tiff.rational(283, 254_000, 1000),
        tiff.shorts(296, 2),
        tiff.shorts(317, 2),
        *([] if deep else [tiff.shorts(320, *tiff.GREY_RAMP)]),
    ]
    return EncodedFrame(tiff.file_bytes([_lzw(pixels)], entries, directory_first=False), sidecar_text(facts).encode("cp1252"))
