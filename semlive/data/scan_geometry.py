"""Settings of a scan that change the geometry of its image, so that frames with different settings must not form a pair."""

from __future__ import annotations

from dataclasses import dataclass, fields

from semlive.data.scan import Sourced

FULL_FRAME = "full frame"
_RELATIVE_TOLERANCE = 1e-3
_NAMES = {
    "tilt_correction": ("tilt correction", ""),
    "tilt_correction_deg": ("tilt correction angle", " degrees"),
    "dynamic_focus": ("dynamic focus", ""),
    "pixel_height_m": ("pixel height", " m"),
    "zoom": ("zoom", "x"),
    "area": ("scan area", ""),
    "interlacing": ("interlacing", ""),
    "drift_correction": ("drift correction", ""),
    "mode": ("scan mode", ""),
}


@dataclass(frozen=True, slots=True)
class ScanGeometry:
    """Settings of a scan that change the geometry of its image; None if the file does not contain a setting.

    Scan rotation and magnification are in `semlive.data.frame.ColumnSettings`, line integration in `semlive.data.scan.ScanTiming`.

    Attributes:
        tilt_correction: rows are moved apart for a tilted specimen: y is stretched by 1 / cos of the angle.
        tilt_correction_deg: angle of the tilt correction; None while it is off.
        dynamic_focus: the focus follows a tilted specimen from row to row, which changes magnification and rotation.
        pixel_height_m: distance of two rows on the specimen.
        zoom: magnification of a part of the scan, 1 without.
        area: ``full frame``, or the scanned part of it in px.
        interlacing: passes in which the rows are written; 1: one after the other.
        drift_correction: the microscope shifted the frames before it averaged them.
        mode: modes of scan and column that have their own distortion, as named in the file.
    """

    tilt_correction: Sourced[bool] | None = None
    tilt_correction_deg: Sourced[float] | None = None
    dynamic_focus: Sourced[bool] | None = None
    pixel_height_m: Sourced[float] | None = None
    zoom: Sourced[float] | None = None
    area: Sourced[str] | None = None
    interlacing: Sourced[int] | None = None
    drift_correction: Sourced[bool] | None = None
    mode: Sourced[str] | None = None

    def values(self) -> dict[str, bool | float | str]:
        """Return the settings that the file contains, by name."""
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: setting.value for name, setting in settings.items() if setting is not None}


def geometry_difference(a: ScanGeometry, b: ScanGeometry) -> str | None:
    """Return the first setting in which `b` differs from `a`, with both values, as a clause; None without one.

    Settings that only one of the two contains are ignored. Lengths, angles and factors are equal within their rounding in headers.
    """
    ours, theirs = a.values(), b.values()
    for name, value in ours.items():
        other = theirs.get(name, value)
        if not _is_equal(value, other):
            label, text = setting_text(name, value)
            return f"{label} {setting_text(name, other)[1]} instead of {text}"
    return None


def geometry_notes(geometry: ScanGeometry, pixel_width_m: float | None) -> tuple[str, ...]:
    """Return what a user has to know about the geometry of one image, one sentence each."""
    notes: list[str] = []
    height_m = None if geometry.pixel_height_m is None else geometry.pixel_height_m.value
    if height_m is not None and pixel_width_m is not None and not _is_equal(height_m, pixel_width_m):
        notes.append(f"its pixels are not square: {pixel_width_m:g} m wide and {height_m:g} m high; the width is used.")
    if geometry.tilt_correction is not None and geometry.tilt_correction.value:
        notes.append("tilt correction is on and stretches the image along y; switch it off, or leave it unchanged during a run.")
    if geometry.dynamic_focus is not None and geometry.dynamic_focus.value:
        notes.append("dynamic focus is on and changes the raster from row to row; switch it off.")
    return tuple(notes)


def setting_text(name: str, value: bool | float | str) -> tuple[str, str]:
    """Return the name of a setting in texts, and its value with unit."""
    label, unit = _NAMES[name]
    if isinstance(value, bool):
        return label, "on" if value else "off"
    return label, value if isinstance(value, str) else f"{value:g}{unit}"


def _is_equal(a: bool | float | str, b: bool | float | str) -> bool:
    if isinstance(a, str) or isinstance(b, str):
        return a == b
    return abs(a - b) <= _RELATIVE_TOLERANCE * max(abs(a), abs(b))
