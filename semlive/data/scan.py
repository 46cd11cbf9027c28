"""Scan of a frame: when each pixel was scanned (Sutton 2007, equations 1-4), and the settings that change the geometry of its image.

Frames whose geometry differs must not form a pair.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")
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


class Provenance(StrEnum):
    """Origin of a value."""

    FILE = "file"
    DERIVED = "derived"
    CONFIG = "config"
    ASSUMED = "assumed"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Sourced(Generic[T]):
    """A value with its origin."""

    value: T
    source: Provenance


@dataclass(frozen=True, slots=True)
class ScanTiming:
    """Timing of one raster scan.

    Attributes:
        dwell_time_s: time on one pixel in one pass, t_D.
        row_time_s: time from the start of one row to the start of the next, t_R, including all passes and fly-backs.
        frame_time_s: time of one complete scan, t_F.
        integrations: number of scans M that were integrated into the image.
        line_integrations: passes over each row that were integrated before the next row.
    """

    dwell_time_s: Sourced[float]
    row_time_s: Sourced[float]
    frame_time_s: Sourced[float]
    integrations: Sourced[int]
    line_integrations: Sourced[int] = Sourced(1, Provenance.ASSUMED)

    def __post_init__(self) -> None:
        for name in ("dwell_time_s", "row_time_s", "frame_time_s", "integrations", "line_integrations"):
            value = getattr(self, name).value
            if not value > 0:
                raise ValueError(f"{name} must be > 0, not {value}")

    @property
    def duration_s(self) -> float:
        """Time from the first pixel's first visit to the end of the last scan."""
        return self.frame_time_s.value * self.integrations.value

    def time_in_frame_s(self, x_px: ArrayLike, y_px: ArrayLike) -> NDArray[np.float64]:
        """Time since the scan began at positions (x, y), mean over the integrated scans (equation 3).

        Positions may be fractional (a subset centre after displacement). With frame integration a pixel is scanned once per scan, so the
        mean time is (M - 1)/2 scans after the first. With L passes over a row, the mean time is (L - 1)/2 passes after the first.
        """
        first_visit_s = np.asarray(x_px) * self.dwell_time_s.value + np.asarray(y_px) * self.row_time_s.value
        passes = self.line_integrations.value
        pass_delay_s = 0.5 * (passes - 1) / passes * self.row_time_s.value
        return first_visit_s + (pass_delay_s + 0.5 * (self.integrations.value - 1) * self.frame_time_s.value)


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
