"""Files that say nothing of their scan: PNG, and TIFF without a vendor's header. Everything comes from the profile."""

from __future__ import annotations

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage


def frame_info(file: ExportedFile, width: int, rows: int, profile: ScanProfile) -> FrameInfo:
    """Everything that profile and modification time say of a frame.

    The file was written when the scan had ended, so its modification time marks the end whatever the profile's anchor is.

    Args:
        file: the exported file.
        width: columns of the image.
        rows: rows of the image, databar included.
        profile: what the user says.

    Raises:
        BadImage: the profile lacks dwell time, row time or pixel size, or they contradict the image.
    """
    needed = {"dwell_time_s": profile.dwell_time_s, "row_time_s": profile.row_time_s, "pixel_size_m": profile.pixel_size_m}
    missing = [f"scan.{key}" for key, value in needed.items() if value is None]
    if profile.dwell_time_s is None or profile.row_time_s is None or profile.pixel_size_m is None:
        raise BadImage(f"{file.name}: says nothing of its scan; set {', '.join(missing)} in the configuration.")
    height = rows - (profile.databar_rows or 0)
    if height < 1:
        raise BadImage(f"{file.name}: has {rows} rows, all of them databar by scan.databar_rows = {profile.databar_rows}; correct it.")
    if min(profile.dwell_time_s, profile.row_time_s, profile.frame_time_s or 1.0, profile.pixel_size_m) <= 0:
        raise BadImage(f"{file.name}: scan times and pixel size must be above zero; correct scan in the configuration.")
    if profile.row_time_s < width * profile.dwell_time_s:
        raise BadImage(
            f"{file.name}: {width} px at scan.dwell_time_s = {profile.dwell_time_s:g} take longer than "
            f"scan.row_time_s = {profile.row_time_s:g}; correct the configuration."
        )
    timing = _timing(profile.dwell_time_s, profile.row_time_s, height, profile)
    return FrameInfo(
        export=file.export,
        name=file.name,
        vendor="plain",
        width_px=width,
        height_px=height,
        databar_rows=rows - height,
        timing=timing,
        start_time_ns=Sourced(file.mtime_ns - round(timing.duration_s * 1e9), Provenance.DERIVED),
        start_sigma_s=profile.start_sigma_s,
        pixel_size_m=Sourced(profile.pixel_size_m, Provenance.CONFIG),
    )


def _timing(dwell_s: float, row_s: float, height: int, profile: ScanProfile) -> ScanTiming:
    if profile.frame_time_s is None:
        frame = Sourced(height * row_s, Provenance.DERIVED)  # Sutton 2007, equation 2
    else:
        frame = Sourced(profile.frame_time_s, Provenance.CONFIG)
    return ScanTiming(
        dwell_time_s=Sourced(dwell_s, Provenance.CONFIG),
        row_time_s=Sourced(row_s, Provenance.CONFIG),
        frame_time_s=frame,
        integrations=Sourced(1, Provenance.ASSUMED),
    )
