"""JEOL: a TIFF without metadata, and a text file of the same name with ``$KEY value`` lines.

It contains no scan time, only numbers of scan speeds, which ``sem.scan_profiles`` maps to times. Rows beyond ``$CM_FULL_SIZE`` are
databar. The pixel size comes from the micron bar, whose length is an integer in px: 53 px for 100 um are accurate to 1 %. Without the
bar there is only the magnification, which needs a calibration: on a 7001F a rule of thumb was 5.7 % off. ``$$SM_COLUMN_MODE`` and
``$$CM_SCAN_MODE`` (a number whose meaning is not public) are compared as they are; no key of tilt correction, dynamic focus or zoom is in
the public files (IT500 and 4700F of delmic/odemis, 7001F and 8530F of misasa/multi_stage).
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from semlive.data.frame import ColumnSettings
from semlive.data.scan import ScanGeometry
from semlive.formats.metadata import key_value
from semlive.formats.metadata.header import Header, derived, from_file, text_from_file
from semlive.formats.metadata.quantity import number, positive, quantity, unread_notes
from semlive.formats.metadata.timestamps import acquired

_USED = ("$$SM_MICRON_BAR", "$$SM_MICRON_MARKER", "$$SM_INTEG_NO", "$CM_MAG")
"""Numbers without which another value is used."""


def read_sidecar(sidecar: bytes, mtime_ns: int = 0) -> Header | None:
    """Return the header from the text file of an image; None for other vendors."""
    values = key_value.parse_dollar_lines(key_value.decode_text(sidecar))
    return header(values, mtime_ns) if any(key.startswith(("$CM_", "$$SM_")) for key in values) else None


def header(values: Mapping[str, str], mtime_ns: int = 0) -> Header:
    """Return the metadata of the scan from the keys; the modification time decides between orders of day and month."""
    time = acquired(values.get("$CM_DATE", ""), values.get("$CM_TIME", ""), "ymd", mtime_ns)
    size = re.fullmatch(r"\s*(\d{1,6})\s+(\d{1,6})\s*", values.get("$CM_FULL_SIZE", ""))
    kilovolts, millimetres = positive(values.get("$CM_ACCEL_VOLT")), positive(values.get("$$SM_WD"))
    pixel_m, notes = _pixel_size(values)
    return Header(
        vendor="jeol",
        instrument=values.get("$CM_INSTRUMENT", ""),
        scan_speed=values.get("$$CM_INSTRUMENT_SCAN_SPEED") or values.get("$$CM_SCAN_SPEED", ""),
        width_px=float(size[1]) if size else None,
        height_px=float(size[2]) if size else None,
        integrations=from_file(positive(values.get("$$SM_INTEG_NO"))),
        pixel_size_m=derived(pixel_m),
        embedded=time.moment,
        unread_time=time.unread,
        column=ColumnSettings(
            detector=text_from_file(values.get("$CM_DETECTOR") or values.get("$CM_DETECTOR_NAME", "")),
            voltage_v=from_file(None if kilovolts is None else kilovolts * 1e3),
            working_distance_m=from_file(None if millimetres is None else millimetres * 1e-3),
            magnification=from_file(positive(values.get("$CM_MAG"))),
            scan_rotation_deg=from_file(number(values.get("$$SM_SCAN_ROTATION"))),
        ),
        geometry=ScanGeometry(mode=text_from_file(_mode(values))),
        notes=notes + unread_notes((key, values.get(key, "")) for key in _USED) + time.notes,
    )


def _mode(values: Mapping[str, str]) -> str:
    modes = (("column", "$$SM_COLUMN_MODE"), ("scan", "$$CM_SCAN_MODE"), ("integration", "$$SM_IMAGE_INTEGRATION_TYPE"))
    return ", ".join((*(f"{name} {values[key]}" for name, key in modes if values.get(key)), *key_value.further_geometry(values)))


def _pixel_size(values: Mapping[str, str]) -> tuple[float | None, tuple[str, ...]]:
    bar_px = positive(values.get("$$SM_MICRON_BAR"))
    marker = quantity(values.get("$$SM_MICRON_MARKER", ""))
    if bar_px is None or marker is None or not marker.value > 0:
        return None, ()
    note = f"its pixel size comes from a micron bar whose length is rounded to {bar_px:g} px, so its uncertainty is {50 / bar_px:.1f} %."
    return marker.value / bar_px, (note,)
