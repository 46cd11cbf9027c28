"""TESCAN: 16 bit, a strip of text below the image, and tag 50431: a binary thumbnail, then ``key=value`` lines.

The tag is a chain of blocks: length of kind and content (u32), kind (u16), content. It contains the dwell time of a pixel, but no row or
frame time. Its date is that of the scan; the DateTime of TIFF is that of saving, some seconds later.
"""

from __future__ import annotations

import struct
from datetime import timedelta

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive_simulators.exporters import databar, tiff
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels

SAVED_AFTER_S = 11
"""Time between the two dates in a file, as in a file of a MIRA3."""
_THUMBNAIL, _MAIN, _SEM = 1, 2, 3
_ROWS_PER_STRIP = 4


def _lines(values: dict[str, object]) -> bytes:
    return "".join(f"{key}={value}\r\n" for key, value in values.items()).encode("cp1252")


def _block(kind: int, content: bytes) -> bytes:
    return struct.pack("<IH", len(content) + 2, kind) + content


def _engineering(value: float) -> str:
    """A number in the format of TESCAN: five digits, with an exponent that is a multiple of three."""
    if value == 0:
        return "0.0"
    exponent = 0
    while abs(value) * 10.0**-exponent < 1.0:
        exponent -= 3
    mantissa = value * 10.0**-exponent
    digits = max(0, 4 - (len(f"{abs(mantissa):.0f}") - 1))
    return f"{mantissa:.{digits}f}e{exponent}" if exponent else f"{mantissa:.{digits}f}"


def tescan_tag(image: NDArray[np.uint8], facts: ImageMetadata, databar_rows: int) -> bytes:
    """The content of tag 50431."""
    scan, end = facts.scan, facts.end_time
    pixel = _engineering(scan.pixel_size_um * 1e-6)
    main = {
        "AccFrames": facts.frames_integrated, "Date": f"{end:%Y-%m-%d}", "Description": "", "Device": "MIRA3 virtual",
        "ImageStripSize": databar_rows,
        "Magnification": f"{0.2768 / (scan.width_px * scan.pixel_size_um * 1e-6):.2f}", "PixelSizeX": pixel, "PixelSizeY": pixel,
        "SerialNumber": "SIMULATED", "TagRevision": 2, "Time": f"{end:%H:%M:%S}", "UserName": "supervisor", "Version": "4.2.13.0",
    }  # fmt: skip
    sem = {
        "Detector": "BSE", "DwellTime": _engineering(scan.dwell_time_s), "HV": "20.0000e3", "ImageShiftX": "0.0", "ImageShiftY": "0.0",
        "LUTGamma": "1.0000", "LUTMaximum": 255, "LUTMinimum": 0, "ScanMode": "RESOLUTION", "ScanRotation": "0.0", "ScanSpeed": 7,
        "StageX": _engineering(facts.stage_x_um * 1e-6), "StageY": _engineering(facts.stage_y_um * 1e-6), "StageZ": "10.000e-3",
        "TiltCorrection": "0.0", "WD": "10.000e-3",
    }  # fmt: skip
    small = cv2.resize(image, (148, max(1, round(148 * image.shape[0] / image.shape[1]))), interpolation=cv2.INTER_AREA)
    _, thumbnail = cv2.imencode(".jpg", small)
    blocks = [_block(_THUMBNAIL, thumbnail.tobytes()), _block(_MAIN, _lines(main)), _block(_SEM, _lines(sem))]
    return b"".join(blocks) + struct.pack("<IH", 2, 0)


def encode(image: Pixels, facts: ImageMetadata, databar_rows: int) -> EncodedFrame:
    """A frame as TESCAN software exports it: 16 bit for any detector."""
    shallow = image.astype(np.uint8) if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    deep = image.astype(np.uint16) * np.uint16(257) if image.dtype == np.uint8 else image
    pixels = databar.appended(deep, facts, databar_rows)
    height, width = pixels.shape
    dots = (2**32 - 1, round((2**32 - 1) * facts.scan.pixel_size_um / 25_400))
    saved = facts.end_time + timedelta(seconds=SAVED_AFTER_S)
    entries = [
        tiff.shorts(256, width),
        tiff.shorts(257, height),
        tiff.shorts(258, 16),
        tiff.shorts(259, 1),
        tiff.shorts(262, 1),
        tiff.text(271, "TESCAN - http://www.tescan.com/"),
        tiff.text(272, "MIRA3 virtual"),
        tiff.shorts(274, 1),
        tiff.shorts(277, 1),
        tiff.shorts(278, _ROWS_PER_STRIP),
        tiff.rational(282, *dots),
        tiff.rational(283, *dots),
        tiff.shorts(284, 1),
        tiff.shorts(296, 2),
        tiff.text(306, f"{saved:%Y:%m:%d %H:%M:%S}"),
        tiff.text(315, "supervisor"),
        tiff.raw_bytes(50431, tescan_tag(shallow, facts, databar_rows)),
    ]
    return EncodedFrame(tiff.file_bytes(tiff.row_strips(pixels, _ROWS_PER_STRIP), entries, directory_first=False))
