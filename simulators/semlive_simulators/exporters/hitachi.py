"""Hitachi: a TIFF without metadata, and a ``[SemImageFile]`` text file with pixel size and date, but without scan times.

The date begins with the day; ``DataSize`` includes the databar.
"""

from __future__ import annotations

from semlive_simulators.exporters import databar, plain
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels


def sidecar_text(facts: ImageMetadata, databar_rows: int) -> str:
    """The content of the text file."""
    scan, end = facts.scan, facts.end_time
    values = {
        "Version": "02-01", "InstructName": "SIMULATED", "SerialNumber": "000000-00", "DataNumber": f"{facts.frame + 1:04d}",
        "SampleName": "", "Format": "TIF", "ImageName": facts.name, "Directory": "C:\\SEM\\", "SaveMode": 2,
        "Date": f"{end:%d/%m/%Y}", "Time": f"{end:%H:%M:%S}", "Media": "DriveC",
        "DataSize": f"{scan.width_px}x{scan.height_px + databar_rows}", "PixelSize": f"{scan.pixel_size_um * 1e3:g}",
        "SignalName": "BSE COMPO", "AcceleratingVoltage": "15000 Volt",
        "Magnification": round(127_000 / (scan.width_px * scan.pixel_size_um)), "WorkingDistance": "10000 um", "Rotation": 0,
        "Vacuum": "High", "MicronMarker": round(0.3 * scan.width_px * scan.pixel_size_um * 1e3), "ScanSpeed": "Slow3",
        "ColorMode": "Grayscale", "StageType": 0, "StagePositionX": round(facts.stage_x_um * 1e3),
        "StagePositionY": round(facts.stage_y_um * 1e3), "StagePositionR": "", "StagePositionZ": "", "StagePositionT": "",
    }  # fmt: skip
    return "".join(["[SemImageFile]\r\n", *(f"{key}={value}\r\n" for key, value in values.items())])


def encode(image: Pixels, facts: ImageMetadata, databar_rows: int) -> EncodedFrame:
    """A frame as Hitachi software exports it."""
    pixels = databar.appended(image, facts, databar_rows)
    return EncodedFrame(plain.tiff_bytes(pixels), sidecar_text(facts, databar_rows).encode("cp1252"))
