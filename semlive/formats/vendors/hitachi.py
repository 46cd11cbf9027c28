"""Hitachi: a TIFF without metadata, and a text file of the same name, ``[SemImageFile]`` or without a section, in ANSI or UTF-16.

It contains no scan time, only a name such as ``Slow3``, which ``sem.scan_profiles`` maps to times. ``DataSize`` includes the databar,
so its height has to be configured. The order of day and month depends on the computer (``16/08/2016`` in one file,
while Bio-Formats expects the month first): if both are possible, the date closer to the modification time of the file is used.
``DigitalZoom`` and ``LensMode`` are in `tm3000_sidecar_blocen.txt` of blocen/SEM_image_TIF_metadata; no key of tilt correction, dynamic
focus or interlacing is known.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from semlive.data.frame import ColumnSettings
from semlive.data.scan import ScanGeometry
from semlive.formats.metadata import key_value
from semlive.formats.metadata.header import Header, from_file, switch, text_from_file
from semlive.formats.metadata.quantity import number, positive, quantity, unread_notes
from semlive.formats.metadata.timestamps import acquired

_HITACHI_KEYS = {"InstructName", "PixelSize", "DataSize", "SignalName", "ScanSpeed", "AcceleratingVoltage"}


def read_sidecar(sidecar: bytes, mtime_ns: int) -> Header | None:
    """Return the header from the text file of an image; None for other vendors."""
    values = key_value.parse_equals_lines(key_value.decode_text(sidecar))
    return header(values, mtime_ns) if len(_HITACHI_KEYS & values.keys()) >= 3 else None


def header(values: Mapping[str, str], mtime_ns: int) -> Header:
    """Return the metadata of the scan from the keys; the modification time selects the order of day and month."""
    size = re.fullmatch(r"\s*(\d{1,6})\s*[xX]\s*(\d{1,6})\s*", values.get("DataSize", ""))
    nanometres = positive(values.get("PixelSize"))
    time = acquired(values.get("Date", ""), values.get("Time", ""), "", mtime_ns)
    return Header(
        vendor="hitachi",
        instrument=values.get("InstructName", ""),
        scan_speed=values.get("ScanSpeed", ""),
        width_px=float(size[1]) if size else None,
        rows=float(size[2]) if size else None,
        pixel_size_m=from_file(None if nanometres is None else nanometres * 1e-9),
        embedded=time.moment,
        unread_time=time.unread,
        column=ColumnSettings(
            detector=text_from_file(values.get("SignalName", "")),
            voltage_v=from_file(_above_zero(values.get("AcceleratingVoltage", ""))),
            working_distance_m=from_file(_above_zero(values.get("WorkingDistance", ""))),
            magnification=from_file(_above_zero(values.get("Magnification", ""))),
            scan_rotation_deg=from_file(number(values.get("Rotation"))),
        ),
        geometry=_geometry(values),
        notes=unread_notes((key, values.get(key, "")) for key in ("PixelSize", "Magnification")) + time.notes,
    )


def _geometry(values: Mapping[str, str]) -> ScanGeometry:
    """Return digital zoom as a factor, or as a mode if the file contains only that it is on."""
    zoom = values.get("DigitalZoom", "")
    is_on = None if zoom.strip() == "1" else switch(zoom)
    factor = 1.0 if is_on is not None and not is_on.value else positive(zoom.lower().strip("x "))
    modes = (values.get("LensMode", ""), "digital zoom" if is_on is not None and is_on.value else "")
    modes += key_value.further_geometry(values, ("DigitalZoom",))
    return ScanGeometry(zoom=from_file(factor), mode=text_from_file(", ".join(filter(None, modes)) or ("normal" if is_on else "")))


def _above_zero(text: str) -> float | None:
    value = quantity(text)
    return value.value if value is not None and value.value > 0 else None
