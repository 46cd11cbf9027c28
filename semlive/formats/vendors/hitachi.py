"""Hitachi: a TIFF without metadata, and a text file of the same name, ``[SemImageFile]`` or without a section, in ANSI or UTF-16.

It contains no scan time, only a name such as ``Slow3``, which ``sem.scan_profiles`` maps to times. ``DataSize`` includes the databar,
so its height has to be configured. The order of day and month depends on the computer (``16/08/2016`` in one file,
while Bio-Formats expects the month first): if both are possible, the date closer to the modification time of the file is used.
In ``PixelSize=1,984`` the comma may be a decimal sign or separate thousands: the other numbers of the file decide, or else the width of the
image at magnification 1, which is the size of a photograph or screen (127 mm in many files, 162 mm of a TM3000).
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
from semlive.formats.metadata.quantity import (
    decimal_sign_of,
    may_be_thousands,
    number,
    positive,
    quantity,
    unread_notes,
    with_decimal_point,
)
from semlive.formats.metadata.timestamps import acquired

_TEXTS = ("Version", "SampleName", "ImageName", "Directory", "Comment", "KeyWord1", "KeyWord2", "DataNumber", "SerialNumber")
"""Keys whose values are no numbers, even if they look like them."""
_SIZES = ("PixelSize", "Magnification")
_GROUPED_KEYS = (*_SIZES, "DataSize", "WorkingDistance", "AcceleratingVoltage")
_GROUPED = re.compile(r"(?<![\d.,'\u2019])\d{1,3}(?:['\u2019]\d{3})+(?!['\u2019\d])")
"""Apostrophes between thousands, as in Switzerland; no other meaning is known."""
_MIN_PRINT_M, _MAX_PRINT_M = 0.03, 1.0
_HITACHI_KEYS = {"InstructName", "PixelSize", "DataSize", "SignalName", "ScanSpeed", "AcceleratingVoltage"}


def read_sidecar(sidecar: bytes, mtime_ns: int) -> Header | None:
    """Return the header from the text file of an image; None for other vendors."""
    values = key_value.parse_equals_lines(key_value.decode_text(sidecar))
    return header(values, mtime_ns) if len(_HITACHI_KEYS & values.keys()) >= 3 else None


def header(values: Mapping[str, str], mtime_ns: int) -> Header:
    """Return the metadata of the scan from the keys; the modification time selects the order of day and month."""
    values, unread_pixel, read = _with_decimal_points(values)
    size = re.fullmatch(r"\s*(\d{1,6})\s*[xX]\s*(\d{1,6})\s*", values.get("DataSize", ""))
    nanometres = positive(values.get("PixelSize"))
    time = acquired(values.get("Date", ""), values.get("Time", ""), "", mtime_ns)
    return Header(
        vendor="hitachi",
        instrument=values.get("InstructName", ""),
        scan_speed=values.get("ScanSpeed", ""),
        width_px=float(size[1]) if size else None,
        rows=float(size[2]) if size else None,
        pixel_size_m=from_file(_above_zero(values.get("PixelSize", "")) if nanometres is None else nanometres * 1e-9),
        unread_pixel=unread_pixel,
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
        notes=read
        + ((f"{unread_pixel}.",) if unread_pixel else ())
        + unread_notes((key, values.get(key, "")) for key in _SIZES)
        + time.notes,
    )


def _with_decimal_points(values: Mapping[str, str]) -> tuple[dict[str, str], str, tuple[str, ...]]:
    """Return the values with decimal points, a clause if the pixel size may have two meanings, and a note if one was chosen.

    ``1.984`` has a decimal point unless other numbers of the file have decimal commas.
    """
    values = {key: _GROUPED.sub(_without_marks, value) if key in _GROUPED_KEYS else value for key, value in values.items()}
    numbers = {key: value for key, value in values.items() if key not in _TEXTS}
    decimal = decimal_sign_of(numbers.values())
    unclear = {key: value for key, value in numbers.items() if may_be_thousands(value)}
    written = unclear.get("PixelSize", "")
    usual = "." if "." in written else ""
    signs = {sign for sign in ".," if _fits_magnification(values, unclear, sign)} if written else set[str]()
    signs = {*(signs if len(signs) == 1 else ()), *([decimal or usual] if decimal or usual else [])}
    if written and len(signs) != 1:
        small, large = sorted((with_decimal_point(written, sign) for sign in ".,"), key=len, reverse=True)
        return {**values, "PixelSize": ""}, f"its PixelSize {written!r} may be {small} or {large} nm", ()
    sign = next(iter(signs), decimal)
    read = {key: with_decimal_point(value, sign) for key, value in unclear.items()} if sign else {}
    reason = "other numbers" if decimal else "magnification"
    is_noted = written and read["PixelSize"] != written
    notes = (f"its PixelSize {written!r} was read as {read['PixelSize']} nm, by its {reason}.",) if is_noted else ()
    return {**values, **read}, "", notes


def _without_marks(match: re.Match[str]) -> str:
    return match[0].replace("'", "").replace("\u2019", "")


def _fits_magnification(values: Mapping[str, str], unclear: Mapping[str, str], sign: str) -> bool:
    """Whether the width of the image at magnification 1 has the size of a photograph or screen, with a decimal sign."""
    pixel, magnified = (with_decimal_point(unclear[key], sign) if key in unclear else values.get(key, "") for key in _SIZES)
    nanometres, magnification = positive(pixel), _above_zero(magnified)
    width_px = positive(values.get("DataSize", "").lower().partition("x")[0])
    if nanometres is None or magnification is None or width_px is None:
        return False
    return _MIN_PRINT_M < nanometres * 1e-9 * width_px * magnification < _MAX_PRINT_M


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
