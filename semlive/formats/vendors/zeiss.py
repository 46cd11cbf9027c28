"""Zeiss: lines ``KEY`` and ``Name = value`` in tag 34118 (cp1252; tag 34119 has the same content as UTF-16).

Observations on real files:

- ``DP_DWELL_TIME`` is 50 or 100 ns in every file and is not the dwell time of the image; that is ``AP_LINE_TIME`` over width and passes.
- ``AP_LINE_TIME`` includes the passes of line averaging: at 10 passes it is 10 times that of one.
- ``AP_FRAME_TIME`` ("Cycle Time") may be printed in tenths of minutes; then the line time is used.
- ``AP_PIXEL_SIZE`` and the fourth number are for an image 1024 px wide.
- A file may be saved in the middle of a scan: ``Busy``, ``DP_FROZEN = Live``, and ``AP_LINE_COUNTER`` is the number of scanned rows.
- Annotation is burnt into the image; no key contains its first row.
- ``DP_TILT_CORRECTION``, ``DP_DYNFOCUS``, ``DP_ZOOM`` and ``DP_SCAN_ROT`` are the states of switches; ``AP_TILT_ANGLE``,
  ``AP_ZOOM_FACTOR`` and ``AP_SCANROTATION`` keep their last values while the switch is off (Crossbeam 550,
  `zeiss_example_sem.tif` of delmic/odemis). No key states whether the raster was reduced: ``AP_RED_RASTER_W`` is there always.
- ``AP_WIDTH`` and ``AP_HEIGHT`` are the field of the stored image, printed with four digits.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise

from semlive.data.frame import ColumnSettings
from semlive.data.scan import Provenance, ScanGeometry, Sourced
from semlive.formats.metadata.header import Header, derived, from_file, switch, text_from_file, unread_switches
from semlive.formats.metadata.quantity import Quantity, number, quantity, unread_notes
from semlive.formats.metadata.timestamps import Acquired, acquired
from semlive.formats.vendors.tiff import Directory, Tag

_MAX_TEXT_BYTES = 2**20
_KEY_STARTS = ("AP_", "DP_", "SV_")
_KEY = re.compile(r"(?:AP|DP|SV)_[A-Z0-9_]{1,40}")
_DISPLAY_PX = 1024
_PIXEL_SIZE_AT = 3
_SAME_PIXEL_SIZE = 1e-2
_USED = ("AP_LINE_TIME", "AP_FRAME_TIME", "AP_PIXEL_SIZE", "AP_IMAGE_PIXEL_SIZE", "AP_LINE_AVERAGE_COUNT", "AP_FRAME_INT_COUNT")
"""Numbers without which another value is used."""
_SWITCHES = ("DP_TILT_CORRECTION", "DP_DYNFOCUS", "DP_ZOOM")
_MODES = {
    "DP_FIELD_MODE": "field mode",
    "DP_FISHEYE_MODE": "fish-eye",
    "DP_LOW_MAG": "low magnification",
    "DP_HIGH_RESOLUTION_MODE": "high resolution",
    "DP_LINE_SCAN": "line scan",
    "DP_WINDOWING": "windowing",
    "DP_EXT_SCAN_CONTROL": "external scan",
    "DP_SCAN_ORTHOG": "orthogonality correction",
}  # switches of scan and column that have their own distortion


@dataclass(frozen=True, slots=True)
class ZeissText:
    """Metadata of a Zeiss file as text.

    Attributes:
        lines: the line after each key.
        numbers: numbers of the block before the first key.
    """

    lines: dict[str, str]
    numbers: tuple[float, ...]

    def text(self, key: str) -> str:
        """Return the text after ``=``; empty without one."""
        _, mark, value = self.lines.get(key, "").partition("=")
        return value.strip() if mark else ""

    def quantity(self, key: str) -> Quantity | None:
        """Return a number above zero in base units, or None."""
        value = quantity(self.text(key))
        return value if value is not None and value.value > 0 else None

    def value(self, key: str) -> float | None:
        """Return a number above zero in base units without its precision, or None."""
        value = self.quantity(key)
        return None if value is None else value.value


def read_header(data: bytes, directory: Directory, width: int, rows: int, mtime_ns: int = 0) -> Header | None:
    """Return the header of a Zeiss file; None for other files."""
    raw = directory.raw(data, Tag.ZEISS)
    if raw is None:
        return None
    return header(parse(_decoded(raw[:_MAX_TEXT_BYTES])), width, rows, mtime_ns)


def parse(text: str) -> ZeissText:
    """Return lines by key; the first of equal keys is used."""
    lines = [line.strip() for line in text[:_MAX_TEXT_BYTES].split("\0", 1)[0].splitlines()]
    by_key: dict[str, str] = {}
    for key, line in pairwise(lines):
        if key.startswith(_KEY_STARTS) and key not in by_key and _KEY.fullmatch(key):
            by_key[key] = line
    first = lines.index(next(iter(by_key))) if by_key else len(lines)
    numbers = [number(line) for line in lines[: min(first, 100)]]
    return ZeissText(by_key, tuple(value for value in numbers if value is not None))


def header(text: ZeissText, width: int, rows: int, mtime_ns: int = 0) -> Header:
    """Return the metadata of a scan of `width` columns and `rows` rows from the text of a Zeiss file."""
    line = text.quantity("AP_LINE_TIME")
    passes, frames, refused, busy = _noise_reduction(text)
    row_s = None if line is None else line.value
    dwell_s = None if row_s is None else row_s / (width * max(passes or 1.0, 1.0))
    scanned, notes = _scanned(text, rows, busy)
    pixel, pixel_notes = _pixel_size(text, width)
    time = _acquired(text, mtime_ns)
    stored = re.fullmatch(r"(\d{1,6})\s*\*\s*(\d{1,6})", text.text("DP_IMAGE_STORE"))
    return Header(
        vendor="zeiss",
        instrument=text.text("DP_SEM") or text.text("SV_SERIAL_NUMBER"),
        scan_speed=text.text("DP_SCANRATE"),
        width_px=float(stored[1]) if stored else None,
        rows=float(stored[2]) if stored else None,
        rows_scanned=scanned,
        dwell_time_s=derived(dwell_s),
        row_time_s=from_file(row_s),
        frame_time_s=_frame_time(text, row_s, rows),
        integrations=from_file(frames),
        line_integrations=from_file(passes),
        pixel_size_m=pixel,
        embedded=time.moment,
        unread_time=time.unread,
        column=ColumnSettings(
            detector=text_from_file(text.text("DP_DETECTOR_CHANNEL") or text.text("DP_DETECTOR_TYPE")),
            voltage_v=from_file(text.value("AP_ACTUALKV") or text.value("AP_MANUALKV")),
            working_distance_m=from_file(text.value("AP_WD")),
            magnification=from_file(text.value("AP_MAG")),
            scan_rotation_deg=_rotation(text),
        ),
        geometry=_geometry(text, width, rows, pixel),
        refused=refused,
        notes=notes + pixel_notes + _unread(text) + time.notes,
    )


def _unread(text: ZeissText) -> tuple[str, ...]:
    return unread_notes((key, text.text(key)) for key in _USED) + unread_switches((key, text.text(key)) for key in _SWITCHES)


def _decoded(raw: bytes) -> str:
    if raw[1:2] == b"\0":
        return raw.decode("utf-16-le", errors="replace")
    return raw.decode("cp1252", errors="replace")


def _noise_reduction(text: ZeissText) -> tuple[float | None, float | None, str | None, bool]:
    """Return passes over a line, integrated scans, the reason for refusal, and whether the scan was unfinished."""
    mode = text.text("DP_NOISE_REDUCTION").lower()
    busy = mode.endswith("busy")
    old = text.value("AP_NR_COEFF")
    if mode.startswith("line"):
        return text.value("AP_LINE_AVERAGE_COUNT") or old or 1.0, 1.0, None, busy
    if mode.startswith("frame int"):
        return 1.0, text.value("AP_FRAME_INT_COUNT") or old or 1.0, None, busy
    averaged = text.value("AP_FRAME_AVERAGE_COUNT") or old or 1.0
    if (mode.startswith(("frame avg", "continuous avg")) and averaged > 1) or mode.startswith("drift"):
        reason = f"is a running average of frames (Noise Reduction = {mode[:20]}), so its pixels have no scan time; use line integration."
        return 1.0, None, reason, busy
    return (1.0, 1.0, None, busy) if mode else (None, None, None, False)


def _scanned(text: ZeissText, rows: int, busy: bool) -> tuple[int | None, tuple[str, ...]]:
    counter = text.value("AP_LINE_COUNTER")
    if not busy or counter is None or counter >= rows:
        return None, ()
    note = f"it was saved in the middle of a scan, when {counter:g} of {rows} rows were written; only those are used."
    return int(counter), (note,)


def _frame_time(text: ZeissText, row_s: float | None, rows: int) -> Sourced[float] | None:
    """Return the cycle time if its printed precision is sufficient, else the time of all rows."""
    cycle = text.quantity("AP_FRAME_TIME")
    if row_s is None or cycle is None or cycle.half_digit > row_s or cycle.value < rows * row_s:
        return derived(None if row_s is None else rows * row_s)
    return from_file(cycle.value)


def _pixel_size(text: ZeissText, width: int) -> tuple[Sourced[float] | None, tuple[str, ...]]:
    """Return the pixel size from the fourth number, which has seven digits where the keys have four, and notes."""
    stated = text.quantity("AP_IMAGE_PIXEL_SIZE")
    exact = text.numbers[_PIXEL_SIZE_AT] if len(text.numbers) > _PIXEL_SIZE_AT else 0.0
    if not 0 < exact < 1:
        shown = text.value("AP_PIXEL_SIZE")
        scaled = derived(None if shown is None else shown * _DISPLAY_PX / width)
        return (scaled if stated is None else from_file(stated.value)), ()
    scaled_m = exact * _DISPLAY_PX / width
    if stated is not None and abs(stated.value - scaled_m) > _SAME_PIXEL_SIZE * stated.value + stated.half_digit:
        note = f"its pixel size is {stated.value:g} m by AP_IMAGE_PIXEL_SIZE and {scaled_m:g} m by its block of numbers; the first is used."
        return from_file(stated.value), (note,)
    return Sourced(scaled_m, Provenance.FILE if width == _DISPLAY_PX else Provenance.DERIVED), ()


def _geometry(text: ZeissText, width: int, rows: int, pixel: Sourced[float] | None) -> ScanGeometry:
    tilt, zoom = switch(text.text("DP_TILT_CORRECTION")), switch(text.text("DP_ZOOM"))
    angle = quantity(text.text("AP_TILT_ANGLE")) if tilt is not None and tilt.value else None
    states = {name: switch(text.text(key)) for key, name in _MODES.items()}
    on = ", ".join(name for name, state in states.items() if state is not None and state.value)
    factor = None if zoom is None else text.value("AP_ZOOM_FACTOR") if zoom.value else 1.0
    averaging = text.text("DP_NOISE_REDUCTION").lower()
    return ScanGeometry(
        tilt_correction=tilt,
        tilt_correction_deg=from_file(None if angle is None else angle.value),
        dynamic_focus=switch(text.text("DP_DYNFOCUS")),
        pixel_height_m=_pixel_height(text, width, rows, pixel),
        zoom=from_file(factor),
        drift_correction=Sourced(averaging.startswith("drift"), Provenance.FILE) if averaging else None,
        mode=text_from_file((on or "normal") if any(state is not None for state in states.values()) else ""),
    )


def _pixel_height(text: ZeissText, width: int, rows: int, pixel: Sourced[float] | None) -> Sourced[float] | None:
    """Return the distance of rows from the field of the image; the pixel size if both are equal within the printed digits."""
    field_x, field_y = text.quantity("AP_WIDTH"), text.quantity("AP_HEIGHT")
    if field_x is None or field_y is None:
        return None
    x_m, y_m = field_x.value / width, field_y.value / rows
    if abs(x_m - y_m) <= field_x.half_digit / width + field_y.half_digit / rows:
        return derived(x_m if pixel is None else pixel.value)
    return derived(y_m)


def _rotation(text: ZeissText) -> Sourced[float] | None:
    if text.text("DP_SCAN_ROT").lower() == "off":
        return Sourced(0.0, Provenance.FILE)
    rotation = quantity(text.text("AP_SCANROTATION"))
    return from_file(None if rotation is None else rotation.value)


def _acquired(text: ZeissText, mtime_ns: int) -> Acquired:
    """Parse ``Date: 11 Apr 2023`` and ``Time :8:20:42``; the place of the colon varies."""
    date, clock = (re.sub(r"^\s*[^\W0-9]+\s*[:=]\s*", "", text.lines.get(key, "")) for key in ("AP_DATE", "AP_TIME"))
    return acquired(date, clock, "dmy", mtime_ns)
