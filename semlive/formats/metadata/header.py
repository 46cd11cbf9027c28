"""Header of an exported file in one form for all vendors, before values are filled in or checked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from semlive.data.frame import ColumnSettings
from semlive.data.scan import Provenance, ScanGeometry, Sourced
from semlive.formats.metadata.timestamps import Moment

_ON = ("on", "yes", "true", "1", "enabled", "active", "ein", "an", "ja")
_OFF = ("off", "no", "false", "0", "disabled", "inactive", "aus", "nein")
_STATES = {**dict.fromkeys(_ON, True), **dict.fromkeys(_OFF, False)}


@dataclass(frozen=True, slots=True)
class Header:
    """Metadata of a scan in a file; None or empty where the file contains no value.

    Attributes:
        vendor: ``fei``, ``zeiss``, ``tescan``, ``jeol``, ``hitachi`` or ``plain``.
        instrument: name of the instrument.
        scan_speed: name or number of the scan speed, for vendors whose files contain it instead of times.
        width_px: width stated in the header.
        height_px: height of the image without databar stated in the header.
        rows: rows with databar stated in the header.
        databar_rows: rows of the databar, if the header contains them besides the height.
        rows_scanned: rows that were written when the file was saved in the middle of a scan.
        dwell_time_s: time on one pixel in one pass.
        row_time_s: time from the start of one row to the start of the next, all passes and fly-backs included.
        frame_time_s: time of one complete scan.
        integrations: number of complete scans that were integrated.
        line_integrations: number of passes over each row that were integrated.
        pixel_size_m: edge of a pixel.
        embedded: date and time in the file.
        unread_time: date and time as written in the file, if they were not understood; empty otherwise.
        unread_pixel: clause on a pixel size with two possible meanings; empty otherwise.
        column: settings of the microscope.
        geometry: settings of the scan that change the geometry of the image.
        refused: reason why the image must not be used, without the name of the file.
        notes: unusual properties, one sentence each.
    """

    vendor: str
    instrument: str = ""
    scan_speed: str = ""
    width_px: float | None = None
    height_px: float | None = None
    rows: float | None = None
    databar_rows: int | None = None
    rows_scanned: int | None = None
    dwell_time_s: Sourced[float] | None = None
    row_time_s: Sourced[float] | None = None
    frame_time_s: Sourced[float] | None = None
    integrations: Sourced[float] | None = None
    line_integrations: Sourced[float] | None = None
    pixel_size_m: Sourced[float] | None = None
    embedded: Moment | None = None
    unread_time: str = ""
    unread_pixel: str = ""
    column: ColumnSettings = field(default_factory=ColumnSettings)
    geometry: ScanGeometry = field(default_factory=ScanGeometry)
    refused: str | None = None
    notes: tuple[str, ...] = ()


def from_file(value: float | None) -> Sourced[float] | None:
    """Return a number of the file with its provenance."""
    return None if value is None else Sourced(value, Provenance.FILE)


def text_from_file(value: str) -> Sourced[str] | None:
    """Return a text of the file with its provenance, shortened to 80 characters."""
    return Sourced(value[:80], Provenance.FILE) if value else None


def switch(text: str | None) -> Sourced[bool] | None:
    """Return the state of a switch with its provenance; None for texts that state none."""
    state = _STATES.get((text or "").strip().lower())
    return None if state is None else Sourced(state, Provenance.FILE)


def unread_switches(values: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return a note for each text by its key that states no state of a switch, so the switch counts as missing."""
    return tuple(f"its {key} {text[:40]!r} was not understood." for key, text in values if text.strip() and switch(text) is None)


def derived(value: float | None) -> Sourced[float] | None:
    """Return a number that was computed from values of the file, with its provenance."""
    return None if value is None else Sourced(value, Provenance.DERIVED)
