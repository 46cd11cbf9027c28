"""Zeiss: text in tag 34118 (the same as UTF-16 in 34119), directory before the pixels, a palette, databar in the image.

A long cycle time is printed in minutes with one decimal, so that only the line time is accurate. Because the directory comes first, a
preallocated and partly written file decodes without error. ``DP_DWELL_TIME`` is in every file and is not the dwell time of the image;
``AP_PIXEL_SIZE`` and the fourth number are those of an image 1024 px wide.
"""

from __future__ import annotations

import numpy as np

from semlive_simulators.exporters import databar, tiff
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels

_TRAP = "50 ns"


def cz_sem_text(facts: ImageMetadata) -> str:
    """The text of tag 34118: four blocks of numbers, then keys and their lines."""
    scan, end = facts.scan, facts.end_time
    pixel_m = scan.pixel_size_um * 1e-6
    display_m = pixel_m * scan.width_px / 1024
    magnification = 0.1143 / (scan.width_px * pixel_m)  # of a Polaroid, 114.3 mm wide
    block = [f"{display_m:.6e}", f"{magnification:.6e}", "6", "2.000000e+04", "2.270000e+00", "2.000000e-10", "1.000000e-02"]
    numbers = ["0", "0", "0", *block, "1", *block, "2", *block, "3", *block, "829"]
    frames = facts.frames_integrated
    noise = "Line Int. Done" if facts.lines_integrated > 1 else "Frame Int. Done" if frames > 1 else "Pixel Avg."
    lines = {
        "DP_OPTIMODE": "OptiBeam Mode = Resolution",
        "DP_DWELL_TIME": f"Dwell Time = {_TRAP}",
        "DP_SCANRATE": "Scan Speed = 12",
        "DP_NOISE_REDUCTION": f"Noise Reduction = {noise}",
        "DP_FROZEN": "Image = Frozen",
        "DP_IMAGE_STORE": f"Store resolution = {scan.width_px} * {scan.height_px}",
        "DP_DETECTOR_CHANNEL": "Signal A = BSD",
        "DP_DETECTOR_TYPE": "Detector = BSD",
        "AP_LINE_AVERAGE_COUNT": f"Line Avg.Count = {facts.lines_integrated}     ",
        "AP_FRAME_AVERAGE_COUNT": "Frames to average = 1     ",
        "AP_FRAME_INT_COUNT": f"Frames to Int. = {frames if frames > 1 else 0}     ",
        "AP_LINE_COUNTER": "Line Counter = 0     ",
        "AP_LINE_TIME": f"Line Time = {_time(facts.line_time_s)}",
        "AP_FRAME_TIME": f"Cycle Time = {_time(facts.frame_time_s)}",
        "AP_WIDTH": f"Width = {_length(scan.width_px * pixel_m)}",
        "AP_HEIGHT": f"Height = {_length(scan.height_px * pixel_m)}",
        "AP_IMAGE_PIXEL_SIZE": f"Image Pixel Size = {_length(pixel_m)}",
        "AP_PIXEL_SIZE": f"Pixel Size = {_length(display_m)}",
        "AP_MAG": f"Mag = {magnification:6.0f} X",
        "AP_WD": "WD = 10.0 mm",
        "AP_ACTUALKV": "EHT = 20.00 kV",
        "AP_SCANROTATION": "Scan Rotation =   0.0 °",
        "AP_STAGE_AT_X": f"Stage at X = {facts.stage_x_um * 1e-3:.4f} mm",
        "AP_STAGE_AT_Y": f"Stage at Y = {facts.stage_y_um * 1e-3:.4f} mm",
        "AP_TIME": f"Time: {end.hour}:{end:%M:%S}",
        "AP_DATE": f"Date: {end.day:2d} {_MONTHS[end.month - 1]} {end.year}",
        "SV_VERSION": "Version = V07.03.00.00 : 07-Feb-23",
        "SV_SERIAL_NUMBER": "Serial No. = SIMULATED",
        "SV_FILE_NAME": f"File Name = {facts.name}",
    }
    keyed = [part for key, line in lines.items() for part in (key, line)]
    return "\r\n".join([*numbers, *keyed, ""])


_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


def _time(seconds: float) -> str:
    """A time in the unit of Zeiss software: five digits, but minutes with one decimal."""
    for unit, scale in (("Secs", 1.0), ("ms", 1e-3)):
        if seconds >= scale:
            return f"{seconds / 60:.1f} Mins" if seconds >= 60 else f"{seconds / scale:.5g} {unit}"
    return f"{seconds * 1e6:.5g}  µs"


def _length(metres: float) -> str:
    """A length in the unit of Zeiss software, with four digits."""
    for unit, scale in (("mm", 1e-3), ("µm", 1e-6)):
        if metres >= scale:
            return f"{metres / scale:.4g} {unit}"
    return f"{metres * 1e9:.4g} nm"


def encode(image: Pixels, facts: ImageMetadata, databar_rows: int) -> EncodedFrame:
    """A frame as SmartSEM exports it; the databar replaces the last rows of the image."""
    pixels = databar.burnt_in(image, facts, databar_rows)
    height, width = pixels.shape
    text = cz_sem_text(facts)
    deep = pixels.dtype == np.uint16
    entries = [
        tiff.longs(254, 0),
        tiff.shorts(256, width),
        tiff.shorts(257, height),
        tiff.shorts(258, 8 * pixels.itemsize),
        tiff.shorts(259, 1),
        tiff.shorts(262, 1 if deep else 3),
        tiff.shorts(274, 1),
        tiff.shorts(277, 1),
        tiff.longs(278, 2**32 - 1),
        tiff.rational(282, 1, 1),
        tiff.rational(283, 1, 1),
        tiff.shorts(296, 1),
        *([] if deep else [tiff.shorts(320, *tiff.GREY_RAMP)]),
        tiff.shorts(339, 1),
        tiff.text(34118, text, "cp1252"),
        tiff.raw_bytes(34119, text.encode("utf-16-le") + b"\0\0"),
    ]
    return EncodedFrame(tiff.file_bytes([tiff.row_strips(pixels, height)[0]], entries, directory_first=True))
