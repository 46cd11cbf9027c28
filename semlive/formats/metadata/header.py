"""What a vendor's header says, in one form for all vendors, before anything is filled in or believed."""

from __future__ import annotations

from dataclasses import dataclass, field

from semlive.data.frame import ColumnSettings
from semlive.data.scan import Provenance, Sourced
from semlive.formats.metadata.timestamps import Moment


@dataclass(frozen=True, slots=True)
class Header:
    """What is said of a scan; None or empty where nothing is said.

    Attributes:
        vendor: ``fei``, ``zeiss``, ``tescan``, ``jeol``, ``hitachi`` or ``plain``.
        instrument: its name.
        scan_speed: the vendor's name or number for it, where it stands for times that the file does not give.
        width_px: width that the header claims.
        height_px: height of the image without databar that the header claims.
        rows: rows with databar that the header claims.
        databar_rows: rows of the databar, where the header tells them apart from the height.
        rows_scanned: rows that were written when the file was saved in the middle of a scan.
        dwell_time_s: time on one pixel in one pass.
        row_time_s: from one row's start to the next, all passes and fly-backs included.
        frame_time_s: of one whole scan.
        integrations: whole scans integrated.
        line_integrations: passes over each row integrated.
        pixel_size_m: edge of a pixel.
        embedded: the date and time in the file.
        column: how the microscope was set.
        refused: why the image must not be used, without the file's name.
        notes: what is unusual, one sentence each.
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
    column: ColumnSettings = field(default_factory=ColumnSettings)
    refused: str | None = None
    notes: tuple[str, ...] = ()


def from_file(value: float | None) -> Sourced[float] | None:
    """A number that stands in the file."""
    return None if value is None else Sourced(value, Provenance.FILE)


def text_from_file(value: str) -> Sourced[str] | None:
    """A text that stands in the file, shortened to what a name can be."""
    return Sourced(value[:80], Provenance.FILE) if value else None


def derived(value: float | None) -> Sourced[float] | None:
    """A number worked out from what stands in the file."""
    return None if value is None else Sourced(value, Provenance.DERIVED)
