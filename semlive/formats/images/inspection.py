"""Inspection of an exported file: its metadata with provenance, and all problems; nothing is refused."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from datetime import UTC, datetime

from semlive.data.frame import ExportedFile
from semlive.data.scan import Provenance, ScanGeometry, Sourced, geometry_notes
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images import frame_metadata
from semlive.formats.images.frames import ParsedFile, check_complete, missing_header, parse_file, read_pixels, read_sidecar
from semlive.formats.metadata.header import Header
from semlive.formats.vendors import greyscale

_UNKNOWN: Sourced[None] = Sourced(None, Provenance.UNKNOWN)
SourcedValue = Sourced[float] | Sourced[int] | Sourced[str] | Sourced[None]


@dataclass(frozen=True, slots=True)
class Inspection:
    """Result of the inspection of one file.

    Attributes:
        name: file name.
        vendor: vendor of the microscope.
        width_px: width of the image; None if unknown.
        height_px: height without databar.
        databar_rows: rows of the databar below the image.
        values: value and provenance by name with unit; the provenance of missing values is `UNKNOWN`.
        acquired: the time in the file as ISO 8601, without zone if the file contains none.
        complete: the file is complete and its scan was finished.
        problems: one sentence each, with what to do.
        notes: unusual properties, one sentence each.
        geometry: settings of the scan that change the geometry of the image.
    """

    name: str
    vendor: str
    width_px: int | None = None
    height_px: int | None = None
    databar_rows: int | None = None
    values: dict[str, SourcedValue] = field(default_factory=dict)
    acquired: Sourced[str] | Sourced[None] = _UNKNOWN
    complete: bool = False
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    geometry: ScanGeometry = field(default_factory=ScanGeometry)


def inspect_file(file: ExportedFile, profile: ScanProfile, vendor: str | None = None) -> Inspection:
    """Inspect an image file.

    Args:
        file: the file, with its sidecar if there is one.
        profile: configured values for metadata that the file lacks.
        vendor: vendor whose header a run requires; None for any.
    """
    try:
        parsed = parse_file(file, profile.page)
    except BadImage as error:
        return Inspection(file.name, "plain", problems=(_without_name(file.name, error),))
    header, width, rows = parsed.header, parsed.width_px, parsed.rows
    problems: list[str] = []
    missing = check_complete(file.data)
    if missing is not None:
        problems.append(f"is incomplete: {missing}; wait until it is written, or export it again.")
    if header.refused is not None:
        problems.append(header.refused)
    if vendor is not None and header.vendor != vendor:
        problems.append(f"{missing_header(vendor)}, which sem.vendor requires; export it with its metadata, or correct sem.vendor.")
    height, values, gap = _values(file, header, width, rows, profile)
    if gap is not None:
        problems.append(gap)
    if (no_time := frame_metadata.missing_time_message(file.name, header)) is not None:
        problems.append(_without_name(file.name, no_time))
    finished, content = _content(parsed, height) if missing is None else (False, None)
    if content is not None:
        problems.append(content)
    return Inspection(
        name=file.name,
        vendor=header.vendor,
        width_px=width,
        height_px=height,
        databar_rows=rows - height,
        values=values,
        acquired=_acquired(header, file),
        complete=finished and header.rows_scanned is None,
        problems=tuple(problems),
        notes=_notes(header, values) + _advice(header, profile),
        geometry=header.geometry,
    )


def inspect_sidecar(name: str, sidecar: bytes, mtime_ns: int, profile: ScanProfile) -> Inspection | None:
    """Inspect a text file without its image; None if no vendor writes such a file."""
    header = read_sidecar(sidecar, mtime_ns)
    if header is None:
        return None
    width, rows = int(header.width_px or 0), int(header.rows or header.height_px or 0)
    file = ExportedFile(0, name, b"", "", mtime_ns, mtime_ns, sidecar)
    height, values, gap = _values(file, header, max(width, 1), max(rows, 1), profile)
    no_image = "is the text file of an image that is not there; keep both in one folder, under one name."
    return Inspection(
        name=name,
        vendor=header.vendor,
        width_px=width or None,
        height_px=height if rows else None,
        databar_rows=rows - height if rows else None,
        values=values,
        acquired=_acquired(header, file),
        problems=(no_image,) if gap is None else (no_image, gap),
        notes=_notes(header, values) + _advice(header, profile),
        geometry=header.geometry,
    )


def as_json(inspection: Inspection, path: str) -> dict[str, object]:
    """Return one element of ``files`` in the output of ``semlive inspect --json``."""
    values = inspection.values
    timing = {name: _json(values.get(name, _UNKNOWN)) for name in ("dwell_time_s", "row_time_s", "frame_time_s", "integrations")}
    return {
        "file": path,
        "vendor": inspection.vendor,
        "width": inspection.width_px,
        "height": inspection.height_px,
        "databar_rows": inspection.databar_rows,
        **timing,
        "pixel_size_m": _json(values.get("pixel_size_m", _UNKNOWN)),
        "acquired": _json(inspection.acquired),
        "complete": inspection.complete,
        "problems": [*inspection.problems, *inspection.notes],
        "geometry": {field.name: _json(getattr(inspection.geometry, field.name) or _UNKNOWN) for field in fields(ScanGeometry)},
    }


def _json(value: SourcedValue) -> dict[str, object]:
    return {"value": value.value, "from": value.source.value}


def _values(
    file: ExportedFile, header: Header, width: int, rows: int, profile: ScanProfile
) -> tuple[int, dict[str, SourcedValue], str | None]:
    """Return the height of the image, all values, and a message about missing or contradictory values."""
    column = header.column
    settings: dict[str, SourcedValue | None] = {
        "detector": column.detector,
        "voltage_v": column.voltage_v,
        "working_distance_m": column.working_distance_m,
        "magnification": column.magnification,
        "scan_rotation_deg": column.scan_rotation_deg,
        "instrument": Sourced(header.instrument, Provenance.FILE) if header.instrument else None,
        "scan_speed": Sourced(header.scan_speed, Provenance.FILE) if header.scan_speed else None,
    }
    timing: dict[str, SourcedValue | None]
    try:
        scan = frame_metadata.fill_missing(file.name, header, width, rows, profile)
        height, gap = scan.height_px, frame_metadata.missing_metadata_message(file.name, header, width, scan)
        timing = {name: getattr(scan, name) for name in _TIMING}
    except BadImage as error:
        height, gap = rows, str(error)
        timing = {name: getattr(header, name) for name in _TIMING}
    ordered = {**{name: timing[name] for name in _TIMING}, **settings}
    return height, {name: value or _UNKNOWN for name, value in ordered.items()}, None if gap is None else _without_name(file.name, gap)


_TIMING = ("dwell_time_s", "row_time_s", "frame_time_s", "integrations", "line_integrations", "pixel_size_m")


def _content(parsed: ParsedFile, height: int) -> tuple[bool, str | None]:
    """Whether the pixels are those of a finished scan, and a message about their problem.

    A preallocated file has zeros in rows that are not written yet. Other uniform rows are a databar, and a completely black image may
    be a finished scan.
    """
    name = parsed.file.name
    try:
        image = read_pixels(parsed)[:height]
    except BadImage as error:
        return "colour" in str(error), _without_name(name, error)
    try:
        greyscale.check_content(name, image)
    except BadImage as error:
        zeros = greyscale.count_blank_rows(image) < height and not image[-1].any()
        return not zeros, _without_name(name, error)
    return True, None


def _notes(header: Header, values: dict[str, SourcedValue]) -> tuple[str, ...]:
    width_m = values["pixel_size_m"].value
    geometry = geometry_notes(header.geometry, width_m if isinstance(width_m, float) else None)
    return header.notes + geometry + frame_metadata.unread_time_notes(header)


def _advice(header: Header, profile: ScanProfile) -> tuple[str, ...]:
    """Return advice on metadata that no file of the vendor contains."""
    if profile.databar_rows is None and header.vendor == "zeiss":
        return ("annotation may be burnt into its last rows; set sem.profile.databar_rows to leave them out.",)
    if profile.databar_rows is None and header.vendor == "hitachi":
        return ("its rows may include a databar; set sem.profile.databar_rows to leave it out.",)
    return ()


def _acquired(header: Header, file: ExportedFile) -> Sourced[str] | Sourced[None]:
    """Return the time of acquisition; a plain file without one was written at the end of its scan, so its modification time is used."""
    if header.embedded is not None:
        return Sourced(header.embedded.text, Provenance.FILE)
    if header.vendor != "plain":
        return _UNKNOWN
    return Sourced(datetime.fromtimestamp(file.mtime_ns // 10**9, UTC).isoformat(), Provenance.DERIVED)


def _without_name(name: str, error: BadImage | str) -> str:
    return str(error).removeprefix(f"{name}: ")
