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
class RowClock:
    """Measured times of the rows of a frame, from the clock of an instrument; they replace equations 1 to 4.

    Attributes:
        row_start_s: time of the first pixel of each row, seconds since the scan began; the mean over the scans that were integrated.
        pixel_time_s: time from pixel to pixel in each row, negative for rows scanned from right to left; empty: the dwell time.
    """

    row_start_s: tuple[float, ...]
    pixel_time_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.row_start_s) < 2:
            raise ValueError(f"a clock needs the starts of at least 2 rows, not {len(self.row_start_s)}")
        if self.pixel_time_s and len(self.pixel_time_s) != len(self.row_start_s):
            raise ValueError(f"the clock has {len(self.row_start_s)} row starts and {len(self.pixel_time_s)} pixel times")
        if not np.isfinite(self.row_start_s).all() or not np.isfinite(self.pixel_time_s).all():
            raise ValueError("the clock holds values that are not finite")

    @classmethod
    def of_channel(cls, time_s: NDArray[np.float64]) -> RowClock:
        """Clock from the measured time of every pixel, (rows, columns), s: a line fitted to each row."""
        column = np.arange(time_s.shape[1]) - 0.5 * (time_s.shape[1] - 1)
        pixel_s = time_s @ column / np.sum(column**2)
        start_s = time_s.mean(axis=1) - 0.5 * (time_s.shape[1] - 1) * pixel_s
        return cls(tuple(start_s.tolist()), tuple(pixel_s.tolist()))

    def time_s(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64], dwell_time_s: float) -> NDArray[np.float64]:
        """Time at positions (x, y), linear between rows; beyond the first and last row with the mean row time."""
        count = len(self.row_start_s)
        start_s = np.asarray(self.row_start_s)
        mean_row_s = (start_s[-1] - start_s[0]) / (count - 1)
        beyond_s = (y_px - np.clip(y_px, 0.0, count - 1.0)) * mean_row_s
        rows = np.arange(count)
        pixel_s = np.interp(y_px, rows, np.asarray(self.pixel_time_s)) if self.pixel_time_s else dwell_time_s
        return np.asarray(np.interp(y_px, rows, start_s) + beyond_s + x_px * pixel_s)


@dataclass(frozen=True, slots=True)
class ScanTiming:
    """Timing of one raster scan.

    Attributes:
        dwell_time_s: time on one pixel in one pass, t_D.
        row_time_s: time from the start of one row to the start of the next, t_R, including all passes and fly-backs.
        frame_time_s: time of one complete scan, t_F.
        integrations: number of scans M that were integrated into the image.
        line_integrations: passes over each row that were integrated before the next row.
        clock: measured times of the rows; None: equations 1 to 4.
    """

    dwell_time_s: Sourced[float]
    row_time_s: Sourced[float]
    frame_time_s: Sourced[float]
    integrations: Sourced[int]
    line_integrations: Sourced[int] = Sourced(1, Provenance.ASSUMED)
    clock: RowClock | None = None

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
        The instrument's own clock replaces all of this.
        """
        if self.clock is not None:
            return self.clock.time_s(np.asarray(x_px, dtype=np.float64), np.asarray(y_px, dtype=np.float64), self.dwell_time_s.value)
        first_visit_s = np.asarray(x_px) * self.dwell_time_s.value + np.asarray(y_px) * self.row_time_s.value
        passes = self.line_integrations.value
        pass_delay_s = 0.5 * (passes - 1) / passes * self.row_time_s.value
        return first_visit_s + (pass_delay_s + 0.5 * (self.integrations.value - 1) * self.frame_time_s.value)

    def time_in_row_s(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Time since the first pixel of the row at positions (x, y), in one pass."""
        if self.clock is None:
            return np.asarray(self.dwell_time_s.value * x_px)
        return self.time_in_frame_s(x_px, y_px) - self.time_in_frame_s(np.zeros_like(x_px), y_px)


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
