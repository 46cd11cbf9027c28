"""Settings that a microscope reports for one scan, read before and after it, and the comparison of the two readings."""

from __future__ import annotations

from dataclasses import dataclass

_RELATIVE_TOLERANCE = 1e-4
"""Relative difference of a time or length that is attributed to the digits of an answer in text, such as ``2.0000e-4``."""


@dataclass(frozen=True, slots=True)
class ScanReading:
    """Settings of a microscope at one instant.

    Attributes:
        time_ns: experiment time of the reading.
        dwell_time_s: time on one pixel in one pass.
        row_time_s: time from the start of one row to the start of the next; None if the microscope does not report it.
        field_width_m: width of the scanned field on the specimen.
        width_px: columns of an image.
        height_px: rows of an image.
        others: further settings as text, sorted by name: scan mode, rotation, detector.
    """

    time_ns: int
    dwell_time_s: float
    row_time_s: float | None
    field_width_m: float
    width_px: int
    height_px: int
    others: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Sort the further settings: the log keeps names and values, not their order."""
        object.__setattr__(self, "others", tuple(sorted(self.others)))

    @property
    def pixel_size_m(self) -> float:
        """Width of a pixel on the specimen."""
        return self.field_width_m / self.width_px

    @property
    def shortest_frame_s(self) -> float:
        """Time of one scan from the row time; without it the time on the pixels alone, which is a lower bound."""
        row_s = self.row_time_s if self.row_time_s is not None else self.width_px * self.dwell_time_s
        return self.height_px * row_s

    def text(self) -> str:
        """Return the settings as one clause."""
        row = "row time not reported" if self.row_time_s is None else f"row time {1e3 * self.row_time_s:.5g} ms"
        more = "".join(f", {name} {value}" for name, value in self.others)
        return (
            f"dwell time {1e6 * self.dwell_time_s:.5g} us, {row}, field width {1e6 * self.field_width_m:.6g} um, "
            f"{self.width_px} x {self.height_px} px{more}"
        )


@dataclass(frozen=True, slots=True)
class ScanReport:
    """A scan that a trigger requested and that is complete.

    Attributes:
        before: settings immediately before the scan.
        after: settings immediately after it, equal to those before within `reading_difference`.
        file: name of the file of the frame in the export folder.
        end_time_ns: experiment time of the end of the scan, as observed by the trigger.
        measured_row_time_s: row time from the arrival of the image data; None if the interface sends none during the scan.
    """

    before: ScanReading
    after: ScanReading
    file: str
    end_time_ns: int
    measured_row_time_s: float | None = None


def reading_difference(before: ScanReading, after: ScanReading) -> str | None:
    """Return the first setting in which two readings differ, with both values, as a clause; None without one.

    A row time or a further setting that only one of the readings contains is ignored.
    """
    if (before.width_px, before.height_px) != (after.width_px, after.height_px):
        return f"{after.width_px} x {after.height_px} px instead of {before.width_px} x {before.height_px}"
    for quantity, unit, first, second in (
        ("dwell time", "s", before.dwell_time_s, after.dwell_time_s),
        ("row time", "s", before.row_time_s, after.row_time_s),
        ("field width", "m", before.field_width_m, after.field_width_m),
    ):
        if first is not None and second is not None and not abs(second - first) <= _RELATIVE_TOLERANCE * abs(first):
            return f"{quantity} {second:g} {unit} instead of {first:g} {unit}"
    later = dict(after.others)
    for name, value in before.others:
        if later.get(name, value) != value:
            return f"{name} {later[name]} instead of {value}"
    return None
