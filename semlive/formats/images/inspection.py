"""What one exported file says, where each value comes from, and what is missing: nothing is refused, everything is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

from semlive.data.frame import ExportedFile
from semlive.data.scan import Provenance, Sourced
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images import frame_metadata
from semlive.formats.images.frames import check_complete, read_header, read_pixels, read_sidecar
from semlive.formats.metadata.header import Header
from semlive.formats.vendors import greyscale

_UNKNOWN: Sourced[None] = Sourced(None, Provenance.UNKNOWN)
SourcedValue = Sourced[float] | Sourced[int] | Sourced[str] | Sourced[None]


@dataclass(frozen=True, slots=True)
class Inspection:
    """One file, looked at.

    Attributes:
        name: of the file.
        vendor: who wrote it.
        width_px: of the image; None if it cannot be told.
        height_px: without databar.
        databar_rows: rows below the image.
        values: by name with unit, each with where it comes from; those that nobody tells are unknown.
        acquired: the time in the file as ISO 8601, without zone where it names none.
        complete: nothing is missing of the file and its scan was finished.
        problems: one sentence each, with what to do.
        notes: what is unusual, one sentence each.
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


def inspect_file(file: ExportedFile, profile: ScanProfile) -> Inspection:
    """Look at an image file.

    Args:
        file: the file, with its sidecar if there is one.
        profile: fills what the file does not say.
    """
    try:
        header, width, rows = read_header(file)
    except BadImage as error:
        return Inspection(file.name, "plain", problems=(_bare(file.name, error),))
    problems: list[str] = []
    missing = check_complete(file.data)
    if missing is not None:
        problems.append(f"is not whole: {missing}; wait until it is written, or export it again.")
    if header.refused is not None:
        problems.append(header.refused)
    height, values, gap = _values(file, header, width, rows, profile)
    if gap is not None:
        problems.append(gap)
    finished, content = _content(file, height) if missing is None else (False, None)
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
        notes=header.notes + _advice(header, profile),
    )


def inspect_sidecar(name: str, sidecar: bytes, mtime_ns: int, profile: ScanProfile) -> Inspection | None:
    """Look at a text file whose image is not there; None if no vendor writes such a file."""
    header = read_sidecar(sidecar, mtime_ns)
    if header is None:
        return None
    width, rows = int(header.width_px or 0), int(header.rows or header.height_px or 0)
    file = ExportedFile(0, name, b"", "", mtime_ns, mtime_ns, sidecar)
    height, values, gap = _values(file, header, max(width, 1), max(rows, 1), profile)
    alone = "is the text beside an image, and the image is not there; keep both in one folder, under one name."
    return Inspection(
        name=name,
        vendor=header.vendor,
        width_px=width or None,
        height_px=height if rows else None,
        databar_rows=rows - height if rows else None,
        values=values,
        acquired=_acquired(header, file),
        problems=(alone,) if gap is None else (alone, gap),
        notes=header.notes + _advice(header, profile),
    )


def as_json(one: Inspection, path: str) -> dict[str, object]:
    """One element of ``files`` in what ``semlive inspect --json`` prints."""
    told = {name: _json(one.values.get(name, _UNKNOWN)) for name in ("dwell_time_s", "row_time_s", "frame_time_s", "integrations")}
    return {
        "file": path,
        "vendor": one.vendor,
        "width": one.width_px,
        "height": one.height_px,
        "databar_rows": one.databar_rows,
        **told,
        "pixel_size_m": _json(one.values.get("pixel_size_m", _UNKNOWN)),
        "acquired": _json(one.acquired),
        "complete": one.complete,
        "problems": [*one.problems, *one.notes],
    }


def _json(value: SourcedValue) -> dict[str, object]:
    return {"value": value.value, "from": value.source.value}


def _values(
    file: ExportedFile, header: Header, width: int, rows: int, profile: ScanProfile
) -> tuple[int, dict[str, SourcedValue], str | None]:
    """Rows of the image, all values, and what is missing or contradicts, with advice."""
    column = header.column
    said: dict[str, SourcedValue | None] = {
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
        found = frame_metadata.fill_missing(file.name, header, width, rows, profile)
        height, gap = found.height_px, frame_metadata.missing_metadata_message(file.name, header, width, found)
        timing = {name: getattr(found, name) for name in _TIMING}
    except BadImage as error:
        height, gap = rows, str(error)
        timing = {name: getattr(header, name) for name in _TIMING}
    ordered = {**{name: timing[name] for name in _TIMING}, **said}
    return height, {name: value or _UNKNOWN for name, value in ordered.items()}, None if gap is None else _bare(file.name, gap)


_TIMING = ("dwell_time_s", "row_time_s", "frame_time_s", "integrations", "line_integrations", "pixel_size_m")


def _content(file: ExportedFile, height: int) -> tuple[bool, str | None]:
    """Whether the pixels are those of a finished scan, and what is wrong with them.

    Zeros at the bottom are what a file is filled with before its rows are; other uniform rows are a databar, and an image that is
    black throughout may be a whole one.
    """
    try:
        image = read_pixels(file)[:height]
    except BadImage as error:
        return "colour" in str(error), _bare(file.name, error)
    try:
        greyscale.check_content(file.name, image)
    except BadImage as error:
        zeros = greyscale.count_blank_rows(image) < height and not image[-1].any()
        return not zeros, _bare(file.name, error)
    return True, None


def _advice(header: Header, profile: ScanProfile) -> tuple[str, ...]:
    """What no file of its vendor tells."""
    if profile.databar_rows is None and header.vendor == "zeiss":
        return ("annotation may be burnt into its last rows; set sem.profile.databar_rows to leave them out.",)
    if profile.databar_rows is None and header.vendor == "hitachi":
        return ("its rows may include a databar; set sem.profile.databar_rows to leave it out.",)
    return ()


def _acquired(header: Header, file: ExportedFile) -> Sourced[str] | Sourced[None]:
    """A file that names no time was written when its scan had ended: its modification time stands for it."""
    if header.embedded is not None:
        return Sourced(header.embedded.text, Provenance.FILE)
    if header.vendor != "plain":
        return _UNKNOWN
    return Sourced(datetime.fromtimestamp(file.mtime_ns // 10**9, UTC).isoformat(), Provenance.DERIVED)


def _bare(name: str, error: BadImage | str) -> str:
    return str(error).removeprefix(f"{name}: ")
