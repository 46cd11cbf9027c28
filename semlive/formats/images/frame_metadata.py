"""Metadata of a frame from header and configuration: the file takes precedence over the configuration, and both over derived values."""

from __future__ import annotations

import math
from dataclasses import dataclass

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.scan import Provenance, ScanTiming, Sourced, geometry_notes
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.metadata.header import Header
from semlive.formats.metadata.timestamps import lacks_seconds

_PRINTED = 1.00001  # factor for values that headers print with six digits
_MAX_VALUES = {"dwell_time_s": 10.0, "row_time_s": 1e4, "frame_time_s": 1e6, "pixel_size_m": 1.0}
_MAX_INTEGRATIONS = 10_000
_MODIFICATION_TIME_SUFFICES = ("plain", "jeol", "hitachi")


@dataclass(frozen=True, slots=True)
class ScanMetadata:
    """Metadata of a scan; missing values are None.

    Attributes:
        height_px: rows of the image without databar and without rows that were not scanned.
        dwell_time_s: time on one pixel in one pass.
        row_time_s: time from the start of one row to the start of the next.
        frame_time_s: time of one complete scan.
        integrations: number of complete scans that were integrated.
        line_integrations: number of passes over each row that were integrated.
        pixel_size_m: edge of a pixel.
    """

    height_px: int
    dwell_time_s: Sourced[float] | None
    row_time_s: Sourced[float] | None
    frame_time_s: Sourced[float] | None
    integrations: Sourced[int]
    line_integrations: Sourced[int]
    pixel_size_m: Sourced[float] | None


_KEY_NAMES = {"dwell_time_s": "dwell time", "row_time_s": "row time", "pixel_size_m": "pixel size"}


def fill_missing(name: str, header: Header, width: int, rows: int, profile: ScanProfile) -> ScanMetadata:
    """Fill the missing values of a header from configuration and arithmetic, as far as possible.

    Raises:
        BadImage: header, image and configuration contradict each other.
    """
    height = _height(name, header, width, rows, profile)
    by_speed = next((speed for speed in profile.speeds if speed.fits(header.instrument, header.scan_speed, width)), None)
    times: dict[str, Sourced[float] | None] = {}
    for key in ("dwell_time_s", "row_time_s", "frame_time_s"):
        configured = None if by_speed is None else getattr(by_speed, key)
        times[key] = _first(name, key, getattr(header, key), configured if configured is not None else getattr(profile, key))
    row = times["row_time_s"]
    frame = times["frame_time_s"] or (None if row is None else Sourced(height * row.value, Provenance.DERIVED))  # Sutton 2007, equation 2
    pixel = _first(name, "pixel_size_m", header.pixel_size_m, profile.pixel_size_m) or _by_magnification(header, width, profile)
    return ScanMetadata(
        height_px=height,
        dwell_time_s=times["dwell_time_s"],
        row_time_s=row,
        frame_time_s=frame,
        integrations=_count(name, "frames", header.integrations),
        line_integrations=_count(name, "passes over each line", header.line_integrations),
        pixel_size_m=pixel,
    )


def frame_info(file: ExportedFile, header: Header, width: int, rows: int, profile: ScanProfile) -> FrameInfo:
    """Return all metadata of a frame.

    Args:
        file: the exported file.
        header: metadata of the file.
        width: columns of the image.
        rows: rows of the image, databar included.
        profile: configured values for metadata that the file lacks.

    Raises:
        BadImage: the file is not an electron scan, its values contradict each other, or a value is missing in file and configuration.
    """
    if header.refused is not None:
        raise BadImage(f"{file.name}: {header.refused}")
    scan = fill_missing(file.name, header, width, rows, profile)
    timing = _timing(file.name, header, width, scan)
    if scan.pixel_size_m is None:
        raise BadImage(_missing(file.name, header, scan))
    start, sigma_s = _start(file, header, timing, profile)
    return FrameInfo(
        export=file.index,
        name=file.name,
        vendor=header.vendor,
        width_px=width,
        height_px=scan.height_px,
        databar_rows=rows - scan.height_px,
        timing=timing,
        start_time_ns=start,
        start_sigma_s=sigma_s,
        pixel_size_m=scan.pixel_size_m,
        column=header.column,
        start_anchor=profile.start_anchor if header.embedded is not None else "end",
        embedded_time_ns=None if header.embedded is None else header.embedded.time_ns,
        notes=header.notes + geometry_notes(header.geometry, scan.pixel_size_m.value) + unread_time_notes(header),
        geometry=header.geometry,
    )


def _height(name: str, header: Header, width: int, rows: int, profile: ScanProfile) -> int:
    if header.width_px is not None and header.width_px != width:
        raise BadImage(f"{name}: is {width} px wide but its header contains {header.width_px:g}; export it unscaled.")
    if header.rows is not None and header.rows != rows:
        raise BadImage(f"{name}: has {rows} rows but its header contains {header.rows:g}; export it uncropped.")
    if header.height_px is not None:
        if not 1 <= header.height_px <= rows or header.height_px != int(header.height_px):
            raise BadImage(f"{name}: has {rows} rows but its header contains {header.height_px:g}; export it uncropped.")
        height = int(header.height_px)
    else:
        bar = header.databar_rows if header.databar_rows is not None else profile.databar_rows or 0
        key = "its header" if header.databar_rows is not None else "sem.profile.databar_rows"
        if not 0 <= bar < rows:
            raise BadImage(f"{name}: has {rows} rows, of which {bar} are databar by {key}; correct sem.profile or export it uncropped.")
        height = rows - bar
    return min(height, header.rows_scanned) if header.rows_scanned is not None and header.rows_scanned >= 1 else height


def _first(name: str, key: str, stated: Sourced[float] | None, configured: float | None) -> Sourced[float] | None:
    value = stated if stated is not None else None if configured is None else Sourced(configured, Provenance.CONFIG)
    if value is not None and not 0 < value.value <= _MAX_VALUES[key]:
        raise BadImage(f"{name}: its {key} of {value.value:g} is impossible; export it again or correct sem.profile.{key}.")
    return value


def _by_magnification(header: Header, width: int, profile: ScanProfile) -> Sourced[float] | None:
    """Derive the pixel size from the magnification by calibration; a rule of thumb was 5.7 % off on a real microscope."""
    if profile.field_width_mm_at_1x is None or header.column.magnification is None:
        return None
    pixel_m = profile.field_width_mm_at_1x * 1e-3 / header.column.magnification.value / width
    return Sourced(pixel_m, Provenance.CONFIG) if 0 < pixel_m <= _MAX_VALUES["pixel_size_m"] else None


def _count(name: str, what: str, stated: Sourced[float] | None) -> Sourced[int]:
    if stated is None:
        return Sourced(1, Provenance.ASSUMED)
    if not 1 <= stated.value <= _MAX_INTEGRATIONS or stated.value != int(stated.value):
        raise BadImage(f"{name}: its header states {stated.value:g} integrated {what}, which is impossible; export it again.")
    return Sourced(int(stated.value), stated.source)


def _missing(name: str, header: Header, scan: ScanMetadata) -> str:
    """Return a message about the values that are missing in file and configuration, and the keys that set them."""
    keys = [key for key in _KEY_NAMES if getattr(scan, key) is None]
    names = [_KEY_NAMES[key] for key in keys]
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    ways = [", ".join(f"sem.profile.{key}" for key in keys)]
    magnification = header.column.magnification
    if "pixel_size_m" in keys and magnification is not None:
        ways.append(f"sem.profile.field_width_mm_at_1x for its magnification {magnification.value:g}")
    if header.scan_speed and keys != ["pixel_size_m"]:
        ways.append(f"a row of sem.scan_profiles for its scan speed {header.scan_speed}")
    if keys == ["pixel_size_m"] and header.unread_pixel:
        return f"{name}: {header.unread_pixel}; set {', or '.join(ways)} in the configuration."
    return f"{name}: does not contain its {listed}; set {', or '.join(ways)} in the configuration."


def missing_time_message(name: str, header: Header) -> str | None:
    """Return the reason for which a frame without a time is refused, one sentence with advice; None if it has one or needs none.

    A file of a vendor whose files may lack a time was written at the end of its scan, so its modification time is sufficient.
    """
    if header.embedded is not None or header.vendor in _MODIFICATION_TIME_SUFFICES:
        return None
    if header.unread_time:
        if lacks_seconds(header.unread_time):
            return f"{name}: its date and time {header.unread_time!r} lack the seconds; set the time format of the microscope's computer."
        advice = "set the date format of the microscope's computer to 2022-03-14 and 24 hours"
        return f"{name}: its date and time {header.unread_time!r} were not understood; {advice}."
    return f"{name}: has no readable time of acquisition; switch the date and time of the export on."


def unread_time_notes(header: Header) -> tuple[str, ...]:
    """Return a note on a date that was not understood, if the modification time replaces it."""
    if header.embedded is not None or not header.unread_time or header.vendor not in _MODIFICATION_TIME_SUFFICES:
        return ()
    return (f"its date and time {header.unread_time!r} were not understood; the modification time of the file is used.",)


def missing_metadata_message(name: str, header: Header, width: int, scan: ScanMetadata) -> str | None:
    """Return the reason for which a frame with this header is refused, one sentence with advice; None if nothing is missing."""
    try:
        _timing(name, header, width, scan)
    except BadImage as error:
        return str(error)
    return _missing(name, header, scan) if scan.pixel_size_m is None else None


def _timing(name: str, header: Header, width: int, scan: ScanMetadata) -> ScanTiming:
    dwell, row, frame = scan.dwell_time_s, scan.row_time_s, scan.frame_time_s
    if dwell is None or row is None or frame is None:
        raise BadImage(_missing(name, header, scan))
    passes = scan.line_integrations.value
    if row.value * _PRINTED < passes * width * dwell.value:
        raise BadImage(
            f"{name}: its row time of {row.value:g} s is shorter than {passes} x {width} px at its dwell time of "
            f"{dwell.value:g} s; {_advice(row, dwell)}"
        )
    if frame.value * _PRINTED < scan.height_px * row.value:
        raise BadImage(
            f"{name}: its frame time of {frame.value:g} s is shorter than {scan.height_px} rows of {row.value:g} s; {_advice(frame, row)}"
        )
    return ScanTiming(dwell, row, frame, scan.integrations, scan.line_integrations)


def _advice(*values: Sourced[float]) -> str:
    configured = any(value.source is Provenance.CONFIG for value in values)
    return "correct sem.profile or sem.scan_profiles." if configured else "export it unscaled and uncropped."


def _start(file: ExportedFile, header: Header, timing: ScanTiming, profile: ScanProfile) -> tuple[Sourced[int], float]:
    """Return the start of the scan and its standard uncertainty.

    The profile defines which instant the embedded time marks. A file without embedded time was written at the end of its scan, so its
    modification time marks the end, whatever the anchor of the profile. In an unfinished scan the time is that of the last row written.
    """
    moment = header.embedded
    if moment is None:
        if (problem := missing_time_message(file.name, header)) is not None:
            raise BadImage(problem)
        return Sourced(file.mtime_ns - round(timing.duration_s * 1e9), Provenance.DERIVED), profile.start_sigma_s
    offset_s = 0.0 if moment.zoned else profile.clock_offset_s
    time_ns = moment.time_ns - round(offset_s * 1e9)
    sigma_s = max(profile.start_sigma_s, moment.sigma_s)
    if profile.start_anchor == "start":
        source = Provenance.FILE if offset_s == 0.0 else Provenance.DERIVED
        return Sourced(time_ns, source), sigma_s
    late_s = profile.save_delay_s if profile.start_anchor == "save" else 0.0
    scanned_s = timing.duration_s if header.rows_scanned is None else header.rows_scanned * timing.row_time_s.value
    if not math.isfinite(scanned_s + late_s):
        raise BadImage(f"{file.name}: its scan would last {scanned_s:g} s; export it again.")
    return Sourced(time_ns - round((scanned_s + late_s) * 1e9), Provenance.DERIVED), sigma_s
