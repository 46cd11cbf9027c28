"""TESCAN: blocks in tag 50431 (a thumbnail, then ``key=value`` lines), or the same keys in the ``.hdr`` file of the image.

A block is its length (u32, of kind and content), its kind (u16) and its content. The header contains the dwell time, but neither row
nor frame time: those come from ``sem.scan_profiles``, by ``ScanSpeed``. Its date is that of the scan; the DateTime tag of TIFF was
11 s later in a file of a MIRA3, and is not read. ``TiltCorrection`` is an angle in degrees, 0 while it is off, and ``ScanMode`` one of
the modes of the column, such as ``WIDE FIELD``, each with its own distortion (`tescan_example_sem1.tif` of delmic/odemis; the extractor of
datasophos/NexusLIMS lists the keys of both sections; none is about dynamic focus).
``RowTime`` (s) is no key of TESCAN: the trigger `sharksem` writes it into the ``.hdr`` file of its frames if the microscope reports it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from semlive.data.frame import ColumnSettings
from semlive.data.scan import Provenance, ScanGeometry, Sourced
from semlive.formats.metadata import key_value
from semlive.formats.metadata.header import Header, from_file, switch, text_from_file, unread_switches
from semlive.formats.metadata.quantity import number, positive, unread_notes
from semlive.formats.metadata.timestamps import acquired
from semlive.formats.vendors.tiff import Directory, Tag

_MAX_BLOCKS = 64
_USED = ("ImageStripSize", "PixelSizeX", "PixelSizeY", "DwellTime", "AccFrames", "ScanRotation")
"""Numbers without which another value is used."""
_READ_ELSEWHERE = ("TiltCorrection",)


def read_header(data: bytes, directory: Directory, mtime_ns: int = 0) -> Header | None:
    """Return the header of a TESCAN file; None for other files."""
    raw = directory.raw(data, Tag.TESCAN)
    if raw is None:
        return None
    values = parse_tag(raw)
    return header(values, mtime_ns) if values else None


def read_sidecar(sidecar: bytes, mtime_ns: int = 0) -> Header | None:
    """Return the header from the ``.hdr`` file of an image; None for other files."""
    values = key_value.parse_equals_lines(key_value.decode_text(sidecar))
    required = {"PixelSizeX", "Device", "DwellTime", "ImageStripSize"} & values.keys()
    return header(values, mtime_ns) if len(required) >= 2 else None


def parse_tag(raw: bytes) -> dict[str, str]:
    """Return the values of all text blocks; if blocks are damaged, the values from ``AccFrames=`` on that can be read."""
    values: dict[str, str] = {}
    at = 0
    for _ in range(_MAX_BLOCKS):
        if at + 6 > len(raw):
            break
        length, _kind = struct.unpack_from("<IH", raw, at)
        content = raw[at + 6 : at + 4 + length]
        if b"=" in content and b"\0" not in content:
            for key, value in key_value.parse_equals_lines(key_value.decode_text(content)).items():
                values.setdefault(key, value)
        at += 4 + max(length, 2)
    if "PixelSizeX" not in values:
        start = raw.find(b"AccFrames=")
        values = key_value.parse_equals_lines(raw[start:].decode("cp1252", errors="replace")) if start >= 0 else values
    return values


def header(values: Mapping[str, str], mtime_ns: int = 0) -> Header:
    """Return the metadata of the scan from the keys; the modification time decides between orders of day and month."""
    time = acquired(values.get("Date", ""), values.get("Time", ""), "ymd", mtime_ns)
    strip = number(values.get("ImageStripSize"))
    x_m, y_m = positive(values.get("PixelSizeX")), positive(values.get("PixelSizeY"))
    tilt_deg, averaging = number(values.get("TiltCorrection")), values.get("AccType", "")
    drift_corrected = "drift" in averaging.lower()
    return Header(
        vendor="tescan",
        instrument=values.get("Device", ""),
        scan_speed=values.get("ScanSpeed", ""),
        databar_rows=int(strip) if strip is not None and 0 <= strip < 10_000 else None,
        dwell_time_s=from_file(positive(values.get("DwellTime"))),
        row_time_s=from_file(positive(values.get("RowTime"))),
        integrations=from_file(positive(values.get("AccFrames"))),
        pixel_size_m=from_file(x_m or y_m),
        embedded=time.moment,
        unread_time=time.unread,
        column=ColumnSettings(
            detector=text_from_file(values.get("Detector") or values.get("Detector0", "")),
            voltage_v=from_file(positive(values.get("HV"))),
            working_distance_m=from_file(positive(values.get("WD"))),
            magnification=from_file(positive(values.get("Magnification"))),
            scan_rotation_deg=from_file(number(values.get("ScanRotation"))),
        ),
        geometry=ScanGeometry(
            tilt_correction=switch(values.get("TiltCorrection")) if tilt_deg is None else Sourced(tilt_deg != 0, Provenance.FILE),
            tilt_correction_deg=from_file(tilt_deg or None),
            pixel_height_m=from_file(y_m),
            drift_correction=Sourced(drift_corrected, Provenance.FILE) if averaging else None,
            mode=text_from_file(
                ", ".join(filter(None, (values.get("ScanMode", ""), *key_value.further_geometry(values, _READ_ELSEWHERE))))
            ),
        ),
        refused=f"the microscope already corrected drift (AccType={averaging[:40]}); accumulate without it." if drift_corrected else None,
        notes=unread_notes((key, values.get(key, "")) for key in _USED) + _unread_tilt(tilt_deg, values) + time.notes,
    )


def _unread_tilt(tilt_deg: float | None, values: Mapping[str, str]) -> tuple[str, ...]:
    return () if tilt_deg is not None else unread_switches([("TiltCorrection", values.get("TiltCorrection", ""))])
