"""Exported files as frames, independent of the vendor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.frame import ExportedFile, Frame, FrameInfo
from semlive.data.scan import RowClock
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage, BadInput
from semlive.formats.images import frame_metadata
from semlive.formats.metadata.header import Header
from semlive.formats.metadata.row_clock import is_row_clock, read_row_clock
from semlive.formats.vendors import fei, greyscale, hitachi, jeol, plain, png, tescan, tiff, tiff_pages, tiff_pixels, zeiss

SIDECAR_VENDORS = ("jeol", "hitachi")
"""Vendors whose header is always in a sidecar, a text file with the name of the image."""

_VENDOR_TAGS = {
    tiff.Tag.FEI_HELIOS: "fei",
    tiff.Tag.FEI_SFEG: "fei",
    tiff.Tag.FEI_XML: "fei",
    tiff.Tag.ZEISS: "zeiss",
    tiff.Tag.TESCAN: "tescan",
}
_UNREAD_TAGS = {
    "DigitalMicrograph of Gatan": (*range(65003, 65012), 65022, 65024, 65025),
    "an Olympus program (SIS)": (33471, 33560),
    "TVIPS": (37706,),
}
"""Private tags of programs whose metadata are not read, as listed by `rsciio.tiff` of hyperspy/rosettasciio."""
_OTHER_FORMATS = {
    b"\xff\xd8\xff": "JPEG",
    b"BM": "BMP",
    b"GIF8": "GIF",
    b"\0\0\0\x0cjP": "JPEG 2000",
    b"RIFF": "WebP",
    b"%PDF": "PDF",
    b"PK": "ZIP",
}
_UNDERSTOOD = ("instrument", "width_px", "rows", "dwell_time_s", "row_time_s", "frame_time_s", "pixel_size_m", "embedded", "unread_time")


@dataclass(frozen=True, slots=True)
class ParsedFile:
    """An exported file after its only parse, without decoded pixels.

    Attributes:
        file: the exported file.
        header: metadata of the file; nothing is filled in.
        width_px: width of the image.
        rows: rows of the image, databar included.
        page: the image of a TIFF file that is read; None for PNG.
    """

    file: ExportedFile
    header: Header
    width_px: int
    rows: int
    page: tiff_pages.Page | None = None


def parse_file(file: ExportedFile, number: int | None = None) -> ParsedFile:
    """Parse the header of an exported file. A header inside the image takes precedence over a sidecar.

    Args:
        file: the exported file.
        number: which image of a TIFF file is the frame, from 1; None if it contains only one frame.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    if tiff.is_tiff(file.data):
        return parse_tiff(file, tiff_pages.find_page(file.data, file.name, number))
    if not png.is_png(file.data):
        raise BadImage(f"{file.name}: {other_format(file.data)}is neither TIFF nor PNG; set the microscope's export to TIFF.")
    width, rows = png.size_px(file.data, file.name)
    return ParsedFile(file, _external_header(file), width, rows)


def other_format(data: bytes) -> str:
    """Return the clause ``is a JPEG file, so it `` for an image of another format; empty if the format is not known."""
    name = next((name for mark, name in _OTHER_FORMATS.items() if data.startswith(mark)), "")
    return f"is a {name} file, so it " if name else ""


def parse_tiff(file: ExportedFile, page: tiff_pages.Page) -> ParsedFile:
    """Parse the header of a TIFF file: that of the image, or else of the first image of the file."""
    data, width, rows, mtime_ns = file.data, page.width_px, page.rows, file.mtime_ns
    directory = page.directory if _VENDOR_TAGS.keys() & page.directory.tags.keys() else page.first
    header = fei.read_header(data, directory, width, rows, mtime_ns) or zeiss.read_header(data, directory, width, rows, mtime_ns)
    header = header or tescan.read_header(data, directory, mtime_ns)
    notes = page.notes + (_unreadable_tag_notes(directory, header) or _unread_tag_notes(directory))
    header = header or _external_header(file)
    return ParsedFile(file, replace(header, notes=header.notes + notes) if notes else header, width, rows, page)


def _unreadable_tag_notes(directory: tiff.Directory, header: Header | None) -> tuple[str, ...]:
    """Return a note if the file has a tag of a vendor but nothing in it was understood."""
    present = [(code, vendor) for code, vendor in _VENDOR_TAGS.items() if code in directory.tags]
    if not present or (header is not None and any(getattr(header, name) for name in _UNDERSTOOD)):
        return ()
    code, vendor = present[0]
    return (f"its metadata in tag {code} of {vendor} cannot be read; export it again, or copy the original file.",)


def _unread_tag_notes(directory: tiff.Directory) -> tuple[str, ...]:
    """Return a note for each program whose private tags the file has."""
    programs = (name for name, codes in _UNREAD_TAGS.items() if any(code in directory.tags for code in codes))
    return tuple(f"its metadata of {name} are not read; state its pixel size and times in sem.profile." for name in programs)


def _external_header(file: ExportedFile) -> Header:
    header = read_sidecar(file.sidecar or b"", file.mtime_ns)
    if header is None and file.sidecar and not is_row_clock(file.sidecar):
        return plain.header("the text file of its name is not that of a known microscope, so it is not used.")
    return header or plain.header()


def read_sidecar(sidecar: bytes, mtime_ns: int) -> Header | None:
    """Parse the text file of an image; None if no vendor writes such a file."""
    return jeol.read_sidecar(sidecar, mtime_ns) or tescan.read_sidecar(sidecar, mtime_ns) or hitachi.read_sidecar(sidecar, mtime_ns)


def read_info(file: ExportedFile, profile: ScanProfile) -> FrameInfo:
    """Return the metadata of a frame from header and profile; no pixel is decoded.

    Args:
        file: the exported file.
        profile: configured values for metadata that the file lacks.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    return parsed_info(parse_file(file, profile.page), profile)


def parsed_info(parsed: ParsedFile, profile: ScanProfile) -> FrameInfo:
    """Return the metadata of a parsed file, as `read_info` does."""
    info = frame_metadata.frame_info(parsed.file, parsed.header, parsed.width_px, parsed.rows, profile)
    clock = _row_clock(parsed.file, info.width_px, info.height_px)
    return info if clock is None else replace(info, timing=replace(info.timing, clock=clock))


def _row_clock(file: ExportedFile, width_px: int, rows: int) -> RowClock | None:
    """Return the clock in the text file of an image whose frame has this size; None if the text is no clock."""
    if file.sidecar is None or not is_row_clock(file.sidecar):
        return None
    try:
        return read_row_clock(file.sidecar, f"the text file of {file.name}", width_px, rows)
    except BadInput as error:
        raise BadImage(str(error)) from error


def read_frame(file: ExportedFile, profile: ScanProfile) -> Frame:
    """Return a frame with its pixels, databar cropped; the scan must be finished.

    Args:
        file: the exported file.
        profile: configured values for metadata that the file lacks.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    parsed = parse_file(file, profile.page)
    info = parsed_info(parsed, profile)
    pixels = read_pixels(parsed)
    # The first rows of a contiguous image are contiguous.
    image: NDArray[np.uint8] | NDArray[np.uint16] = pixels[: info.height_px]
    greyscale.check_content(file.name, image)
    return Frame(info, image)


def check_complete(data: bytes) -> str | None:
    """Return what is missing of an image file, a clause; None if it is complete (pixels are not decoded)."""
    if tiff.is_tiff(data):
        return tiff.check_complete(data)
    if png.is_png(data):
        return png.check_complete(data)
    return "it is neither TIFF nor PNG"


def check_finished(file: ExportedFile, profile: ScanProfile, vendor: str | None = None) -> str | None:
    """Return what a structurally complete file still lacks: the header of its vendor, a complete sidecar that matches, or its last rows.

    Args:
        file: the file, with its sidecar if there is one.
        profile: number of databar rows for files that do not contain it.
        vendor: vendor whose header the file must have; None for any.

    Returns:
        A clause; None if nothing is missing.
    """
    try:
        parsed = parse_file(file, profile.page)
    except tiff_pages.SeveralFrames:
        return None  # complete; `read_frame` states why it is not used
    except BadImage as error:
        return str(error).removeprefix(f"{file.name}: ").rstrip(".")
    header, width, rows = parsed.header, parsed.width_px, parsed.rows
    if vendor is not None and header.vendor != vendor:
        return missing_header(vendor)
    if header.width_px not in (None, width) or header.rows not in (None, rows):
        return f"it is {width} x {rows} px, but its header describes another image"
    bar = rows - int(header.height_px) if header.height_px else header.databar_rows or profile.databar_rows or 0
    try:
        _row_clock(file, width, rows - bar)
    except BadImage as error:
        return str(error).rstrip(".")
    if parsed.page is None:
        return None
    zeros = tiff.zero_rows(file.data, parsed.page.directory, rows - bar)
    return f"its last {zeros} rows are zero" if zeros >= 2 else None


def missing_header(vendor: str) -> str:
    """Return the clause about a file without the header of its vendor."""
    return f"it has no header of {vendor}" + (" in a text file of the same name" if vendor in SIDECAR_VENDORS else "")


def ends_like_partial_file(data: bytes) -> bool:
    """Whether a complete file ends like one that is still being filled; the texts of some programs end in the same way."""
    return tiff.is_tiff(data) and tiff.ends_in_zeros(data)


def read_pixels(parsed: ParsedFile) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return all pixels as one grey channel, databar included.

    Raises:
        BadImage: one sentence: file, what is wrong, what to do.
    """
    data, name, page = parsed.file.data, parsed.file.name, parsed.page
    if page is None:
        return greyscale.to_greyscale(name, png.read_pixels(data, name), tiff_pixels.Photometric.BLACK_IS_ZERO)
    return tiff_to_greyscale(data, name, page, tiff_pixels.read_pixels(data, name, page))


def tiff_to_greyscale(data: bytes, name: str, page: tiff_pages.Page, pixels: NDArray[np.generic]) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the decoded pixels of a TIFF file as one grey channel.

    Raises:
        BadImage: the pixels are coloured or of another type than 8 or 16 bit.
    """
    directory = page.directory
    photometric = directory.integer(data, tiff.Tag.PHOTOMETRIC, tiff_pixels.Photometric.BLACK_IS_ZERO)
    palette, bits = directory.integers(data, tiff.Tag.COLOR_MAP), tiff_pixels.bits_per_sample(data, directory)
    return greyscale.to_greyscale(name, pixels, photometric, palette, bits)
