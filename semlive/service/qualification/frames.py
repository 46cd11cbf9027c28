"""Frames of a folder in the order of their capture, with times and shifts from ``frames.csv`` if it exists."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

from semlive.data.frame import ExportedFile, Frame
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage, BadInput
from semlive.formats import read_frame, read_info
from semlive.formats.images.image_files import NO_SCAN
from semlive.formats.tables.frame_table import FrameRow, read_frame_table
from semlive.inputs.files import MAX_IMAGE_BYTES, read_regular
from semlive.service.watch.sidecars import IMAGE_SUFFIXES, sidecar_of

TABLE = "frames.csv"
_MAX_TABLE_BYTES = 10**8
NO_SCAN_FRAME_S = 1e4
"""Interval that is assumed between frames without times; longer than any scan, so that they do not overlap."""
_ZERO_NS = 946_684_800_000_000_000
"""Origin of times that have no date: 2000-01-01, UTC ns."""


@dataclass(frozen=True, slots=True)
class FolderFrame:
    """A file of the folder.

    Attributes:
        path: image file.
        row: its line in ``frames.csv``; None without the table.
        timed: whether the times of its scan are given by the file, the configuration or the table.
        sized: whether its pixel size is given.
        start_ns: start of its scan, UTC ns; from the origin of the table if no file has a time, and without both a running number.
        file_ns: start of its scan by the file, UTC ns; None without a time in the file.
        profile: values with which it is read.
    """

    path: Path
    row: FrameRow | None
    timed: bool
    sized: bool
    start_ns: int
    file_ns: int | None
    profile: ScanProfile


def list_frames(folder: Path, profile: ScanProfile) -> tuple[FolderFrame, ...]:
    """List the frames of a folder in the order of their capture.

    Args:
        folder: folder of exported images; ``frames.csv`` in it, or next to it, gives times and commanded shifts.
        profile: values for metadata that the files lack.

    Raises:
        BadInput: the folder has fewer than two images, or the table has another number of frames.
    """
    try:
        paths = sorted((path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES), key=_natural)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be read ({error.strerror}); give a folder of exported images") from error
    if len(paths) < 2:
        raise BadInput(f"{folder}: contains {len(paths)} images (.tif, .tiff, .png); a qualification needs at least one pair of frames")
    rows = _table(folder)
    if rows and len(rows) != len(paths):
        raise BadInput(f"{folder}: contains {len(paths)} images, but {TABLE} lists {len(rows)} frames; list every frame once")
    found = [_listed(path, row, number, profile) for number, (path, row) in enumerate(zip(paths, rows or [None] * len(paths), strict=True))]
    if found[0].row is not None and found[0].file_ns is not None:  # the times of the table, at the day of the files
        origin_ns = found[0].file_ns - found[0].start_ns
        found = [replace(frame, start_ns=frame.start_ns + origin_ns) for frame in found]
    return tuple(sorted(found, key=lambda frame: frame.start_ns)) if all(frame.timed for frame in found) else tuple(found)


def load_frame(frame: FolderFrame, number: int) -> Frame:
    """Decode a frame.

    Args:
        frame: the file.
        number: its number in the order of capture.

    Raises:
        BadImage: the file cannot be read.
    """
    loaded = read_frame(exported(frame.path, number), frame.profile)
    info, timing = loaded.info, loaded.info.timing
    if not frame.sized:
        info = replace(info, pixel_size_m=Sourced(0.0, Provenance.UNKNOWN))
    if frame.row is not None:
        source = Provenance.CONFIG if frame.file_ns is None else Provenance.DERIVED
        info = replace(info, timing=_row_timing(frame.row), start_time_ns=Sourced(frame.start_ns, source), start_sigma_s=0.0)
        if frame.row.rotation_deg is not None:
            rotation = Sourced(frame.row.rotation_deg, Provenance.CONFIG)
            info = replace(info, column=replace(info.column, scan_rotation_deg=rotation))
    elif not frame.timed:
        timing = replace(timing, **{name: Sourced(getattr(timing, name).value, Provenance.ASSUMED) for name in _TIMES})
        info = replace(info, timing=timing, start_time_ns=Sourced(frame.start_ns, Provenance.ASSUMED))
    return Frame(info, loaded.image)


_TIMES = ("dwell_time_s", "row_time_s", "frame_time_s")


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name.casefold())]


def _table(folder: Path) -> tuple[FrameRow, ...]:
    for path in (folder / TABLE, folder.parent / TABLE):
        if path.is_file():
            return read_frame_table(read_regular(path, _MAX_TABLE_BYTES), str(path))
    return ()


def exported(path: Path, number: int) -> ExportedFile:
    """An image file with its text file.

    Raises:
        BadImage: it cannot be read.
    """
    try:
        data, mtime_ns = read_regular(path, MAX_IMAGE_BYTES), path.stat().st_mtime_ns
        sidecar = sidecar_of(path)
        text = None if sidecar is None else read_regular(sidecar, MAX_IMAGE_BYTES)
    except OSError as error:
        raise BadImage(f"{path}: cannot be read ({error.strerror}); give exported image files") from error
    return ExportedFile(number, path.name, data, "", mtime_ns, mtime_ns, text)


def _listed(path: Path, row: FrameRow | None, number: int, profile: ScanProfile) -> FolderFrame:
    if row is not None:
        own = profile.pixel_size_m if row.pixel_nm is None else 1e-9 * row.pixel_nm
        given = replace(profile, dwell_time_s=row.dwell_s, row_time_s=row.row_time_s, frame_time_s=None, pixel_size_m=own)
        start_ns = _ZERO_NS + round(1e9 * row.start_s)
    else:
        given, start_ns = profile, _ZERO_NS + round(1e9 * number * NO_SCAN_FRAME_S)
    file = exported(path, number)
    try:
        info = read_info(file, given)
    except BadImage:  # also if only the pixel size is missing
        size_m = given.pixel_size_m or NO_SCAN.pixel_size_m
        completed = replace(NO_SCAN if row is None else given, pixel_size_m=size_m, databar_rows=profile.databar_rows)
        read_info(file, completed)
        return FolderFrame(path, row, row is not None, given.pixel_size_m is not None, start_ns, None, completed)
    file_ns = None if info.embedded_time_ns is None else info.start_time_ns.value
    timed = row is not None or file_ns is not None
    return FolderFrame(path, row, timed, True, start_ns if row is not None or file_ns is None else file_ns, file_ns, given)


def _row_timing(row: FrameRow) -> ScanTiming:
    source = Provenance.CONFIG
    return ScanTiming(
        Sourced(row.dwell_s, source),
        Sourced(row.row_time_s, source),
        Sourced(row.height * row.row_time_s, Provenance.DERIVED),
        Sourced(row.integrations, source),
    )
