"""FEI and Thermo Fisher files: the INI text in tag 34682 (Helios) or 34680 (SFEG), the XML in tag 34683, or text after the pixels.

Observations on real files:

- Row time is ``[EScan] LineTime``: fly-back varies from file to file at equal dwell (220 to 520 us per pass), so it is never
  computed from the dwell. LineTime includes all passes of line integration; dwell is that of one pass.
- The duration of the scan is FrameTime times the integrated frames, ``[Image] Integrate``; ``[Scan] Integrate`` may be 1 in the same file.
- The rows of the file beyond ``[Image] ResolutionY`` are the databar; ``DatabarHeight`` is 0 in files with a databar.
- Of a reduced area, ``[Image]`` contains the size of the full frame; the scanned part is HorFieldsize / PixelWidth columns and
  VerFieldsize / PixelHeight rows (2243 x 1088 of 3072 x 2048 px in the header of a Helios 5, public test data of a program that writes
  such headers: [EBeam] TiltCorrectionIsOn, DynamicFocusIsOn and TiltCorrectionAngle in rad are from there, too). XML text contains the
  area as ``ScanSettings/ScanArea`` of ``ScanSettings/ScanSize``, and ``Optics/SampleTiltCorrectionOn`` (FAIRmat-NFDI/pynxtools-em,
  docs/reference/tiff_fei.md). ZoomFactor, ScanInterlacing and LensMode are in `FEI-Helios-Ebeam-8bits.tif` of hyperspy/rosettasciio.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from xml.etree import ElementTree

from semlive.data.frame import ColumnSettings
from semlive.data.scan import FULL_FRAME, Provenance, ScanGeometry, Sourced
from semlive.formats.metadata.header import Header, from_file, switch, text_from_file, unread_switches
from semlive.formats.metadata.quantity import number, positive, unread_notes
from semlive.formats.metadata.timestamps import Acquired, acquired, iso
from semlive.formats.vendors.tiff import Directory, Tag

_MAX_TEXT_BYTES = 2**20
_TAIL_BYTES = 2**18
_USED = (
    "Image/ResolutionX",
    "Image/ResolutionY",
    "EScan/Dwell",
    "EScan/LineTime",
    "EScan/FrameTime",
    "EScan/PixelWidth",
    "EScan/PixelHeight",
    "EScan/LineIntegration",
    "Image/Integrate",
    "Image/Average",
    "Image/ZoomFactor",
    "Beam/ScanRotation",
)
"""Numbers without which another value is used, or none."""
_SWITCHES = ("EBeam/TiltCorrectionIsOn", "EBeam/DynamicFocusIsOn", "EBeam/DynamicWDIsOn", "Image/DriftCorrected")
"""Their texts and those of the passes of interlacing are reported if they are not understood."""
_PRINTED = 1.00001  # factor for values that headers print with six digits


@dataclass(frozen=True, slots=True)
class FeiText:
    """Metadata of an FEI file as text.

    Attributes:
        ini: value by ``section/key``.
        xml: text by ``parent/element``.
    """

    ini: dict[str, str]
    xml: dict[str, str]

    def text(self, *paths: str) -> str:
        """Return the first non-empty value of the paths; for each path the INI text takes precedence over the XML text."""
        for path in paths:
            value = self.ini.get(path) or self.xml.get(path) or ""
            if value:
                return value
        return ""

    def number(self, *paths: str) -> float | None:
        """Return the first value of the paths that is a finite number above zero."""
        for path in paths:
            for source in (self.ini, self.xml):
                value = positive(source.get(path))
                if value is not None:
                    return value
        return None


def read_text(data: bytes, directory: Directory) -> FeiText | None:
    """Return the text of an FEI file; None for other files."""
    ini = directory.text(data, Tag.FEI_HELIOS) or directory.text(data, Tag.FEI_SFEG) or _tail_text(data)
    xml = directory.text(data, Tag.FEI_XML)
    if not ini and not xml:
        return None
    return FeiText(parse_ini(ini or ""), parse_xml(xml or ""))


def parse_ini(text: str) -> dict[str, str]:
    """Return values by ``section/key``; the last of equal keys is used."""
    values: dict[str, str] = {}
    section = ""
    for line in text[:_MAX_TEXT_BYTES].splitlines():
        line = line.strip()
        if line.startswith("[") and line.endswith("]"):
            section = line[1:-1]
        elif "=" in line:
            key, value = line.split("=", 1)
            values[f"{section}/{key.strip()}"] = value.strip()
    return values


def parse_xml(text: str) -> dict[str, str]:
    """Return texts by ``parent/element``, names without namespace; the first of equal paths is used. Empty if the text is not XML."""
    text = text.strip().lstrip("\ufeff").lstrip()
    if not text or len(text) > _MAX_TEXT_BYTES or "<!DOCTYPE" in text or "<!ENTITY" in text:
        return {}
    try:
        root = ElementTree.fromstring(text.encode("utf-8", errors="replace"))
    except (ElementTree.ParseError, ValueError):
        return {}
    values: dict[str, str] = {}
    for parent in root.iter():
        for child in parent:
            path = f"{_local(parent.tag)}/{_local(child.tag)}"
            values.setdefault(path, (child.text or "").strip())
    return values


def read_header(data: bytes, directory: Directory, width: int, rows: int, mtime_ns: int = 0) -> Header | None:
    """Return the header of an FEI file; None for other files."""
    text = read_text(data, directory)
    return None if text is None else header(text, width, rows, mtime_ns)


def header(text: FeiText, width: int | None = None, rows: int = 0, mtime_ns: int = 0) -> Header:
    """Return the metadata of the scan from the text of an FEI file whose image has `width` columns, if known, and `rows` rows."""
    time = _acquired(text, mtime_ns)
    area = _area(text, width, rows)
    frames = text.number("Image/Integrate", "EScan/Integrate", "Scan/Integrate") or _frames_filtered(text)
    return Header(
        vendor="fei",
        instrument=text.text("System/SystemType", "Instrument/InstrumentModel", "Instrument/InstrumentClass"),
        width_px=area.width_px,
        height_px=area.height_px,
        dwell_time_s=from_file(text.number("EScan/Dwell", "Scan/Dwelltime", "ScanSettings/DwellTime")),
        row_time_s=from_file(text.number("EScan/LineTime", "ScanSettings/LineTime")),
        frame_time_s=from_file(text.number("EScan/FrameTime", "Scan/FrameTime", "ScanSettings/FrameTime")),
        integrations=from_file(frames),
        line_integrations=from_file(text.number("EScan/LineIntegration", "ScanSettings/LineIntegrationCount")),
        pixel_size_m=from_file(text.number("EScan/PixelWidth", "Scan/PixelWidth", "PixelSize/X")),
        embedded=time.moment,
        unread_time=time.unread,
        column=_column(text),
        geometry=_geometry(text, area),
        refused=_processed(text) or area.refused,
        notes=_notes(text) + time.notes,
    )


def _column(text: FeiText) -> ColumnSettings:
    rotation_rad = number(text.text("Beam/ScanRotation", "EBeam/ScanRotation", "ScanSettings/ScanRotation"))
    return ColumnSettings(
        detector=text_from_file(text.text("Detectors/Name", "Detectors/Signal", "ScanningDetector/DetectorName")),
        voltage_v=from_file(text.number("Beam/HV", "EBeam/HV", "Optics/AccelerationVoltage")),
        working_distance_m=from_file(text.number("EBeam/WD", "Stage/WorkingDistance", "Optics/WorkingDistance")),
        scan_rotation_deg=from_file(None if rotation_rad is None else math.degrees(rotation_rad)),
    )


@dataclass(frozen=True, slots=True)
class _Area:
    """Expected size of the image, the part of the full frame that was scanned, and why the image cannot be that part."""

    width_px: float | None
    height_px: float | None
    name: str
    refused: str | None = None


def _area(text: FeiText, width: int | None, rows: int) -> _Area:
    """Return the scanned area: that of the header if the image has its size, otherwise the full frame."""
    full_x, full_y = text.number("Image/ResolutionX", "ScanSize/Width"), text.number("Image/ResolutionY", "ScanSize/Height")
    stated = text.number("Image/ResolutionX"), text.number("Image/ResolutionY")
    x = _points(text, "HorFieldsize", "PixelWidth") or text.number("ScanArea/Width")
    y = _points(text, "VerFieldsize", "PixelHeight") or text.number("ScanArea/Height")
    if x is None or y is None or full_x is None or full_y is None or width is None:
        return _Area(*stated, "")
    if (x, y) == (full_x, full_y) or x > full_x or y > full_y:
        return _Area(*stated, FULL_FRAME)
    part = f"{x:g} x {y:g} of {full_x:g} x {full_y:g} px"
    has_full_size = width == full_x and rows >= full_y
    if width == x and rows >= y and not has_full_size:
        offset = text.text("ScanArea/X"), text.text("ScanArea/Y")
        return _Area(x, y, f"{part} from ({', '.join(offset)})" if all(offset) else part)
    line_s, frame_s = text.number("EScan/LineTime", "ScanSettings/LineTime"), text.number("EScan/FrameTime", "ScanSettings/FrameTime")
    if has_full_size and (line_s is None or frame_s is None or frame_s * _PRINTED >= full_y * line_s):
        return _Area(*stated, FULL_FRAME)
    return _Area(None, None, part, f"only a reduced area of {part} was scanned, but it has {width} x {rows} px; export that area unscaled.")


def _points(text: FeiText, field: str, pixel: str) -> float | None:
    """Return the number of scanned points along a side of the field; None if the header does not contain it."""
    field_m, pixel_m = text.number(f"EScan/{field}", f"Scan/{field}"), text.number(f"EScan/{pixel}", f"Scan/{pixel}")
    return None if field_m is None or pixel_m is None else float(round(field_m / pixel_m))


def _geometry(text: FeiText, area: _Area) -> ScanGeometry:
    tilt = switch(text.text("EBeam/TiltCorrectionIsOn", "Optics/SampleTiltCorrectionOn"))
    angle_rad = number(text.text("EBeam/TiltCorrectionAngle", "Optics/SamplePreTiltAngle"))
    focus = [state for key in ("EBeam/DynamicFocusIsOn", "EBeam/DynamicWDIsOn") if (state := switch(text.text(key))) is not None]
    interlacing = _interlacing(text)
    averaging = text.text("Image/DriftCorrected", "BinaryResult/FilterType")
    corrections = ("MagnificationCorrection", "MagnificationSinglePointCorrectionIsOn")
    modes = [text.text("EBeam/LensMode", "Optics/OpticalMode"), *(key for key in corrections if _is_on(text, f"EBeam/{key}"))]
    return ScanGeometry(
        tilt_correction=tilt,
        tilt_correction_deg=from_file(math.degrees(angle_rad)) if tilt is not None and tilt.value and angle_rad is not None else None,
        dynamic_focus=Sourced(any(state.value for state in focus), Provenance.FILE) if focus else None,
        pixel_height_m=from_file(text.number("EScan/PixelHeight", "Scan/PixelHeight", "PixelSize/Y")),
        zoom=from_file(text.number("Image/ZoomFactor")),
        area=text_from_file(area.name),
        interlacing=None if interlacing is None else Sourced(int(interlacing), Provenance.FILE),
        drift_correction=Sourced(_is_drift_corrected(text), Provenance.FILE) if averaging else None,
        mode=text_from_file(", ".join(filter(None, modes))),
    )


def _interlacing(text: FeiText) -> float | None:
    """Return the passes in which the rows were written; 2 if the file contains only that there were several."""
    keys = ("EScan/ScanInterlacing", "ScanSettings/LineInterlacing")
    stated, state = text.number(*keys), switch(text.text(*keys))
    return stated if stated is not None or state is None else 1.0 + state.value


def _is_on(text: FeiText, key: str) -> bool:
    state = switch(text.text(key))
    return state is not None and state.value


def _is_drift_corrected(text: FeiText) -> bool:
    """Whether frames were shifted before they were averaged; the filter of the XML text does nothing to a single frame."""
    several = (text.number("BinaryResult/FilterFrameCount") or 0) > 1
    return _is_on(text, "Image/DriftCorrected") or (several and "DriftCorrected" in text.text("BinaryResult/FilterType"))


def _processed(text: FeiText) -> str | None:
    beam = text.text("Beam/Beam")
    scanned = text.number("EScan/Dwell", "Scan/Dwelltime", "ScanSettings/DwellTime", "EScan/LineTime")
    if scanned is None and beam and beam != "EBeam":
        return f"was not scanned with the electron beam ([Beam] Beam={beam[:20]}); export the electron image."
    if _is_drift_corrected(text):
        key = "DriftCorrected=On" if _is_on(text, "Image/DriftCorrected") else "FilterType=DriftCorrected..."
        return f"the microscope already corrected drift ({key}); switch drift-corrected integration off."
    if (text.number("Image/Average", "EScan/Average", "Scan/Average") or 0) > 1:
        return "is a running average of frames, so its pixels have no scan time; integrate instead of averaging."
    if (_interlacing(text) or 1) > 1:
        return "was scanned interlaced, so its rows were not written in order; switch interlacing off."
    return None


def _notes(text: FeiText) -> tuple[str, ...]:
    numbers = unread_notes((path, text.text(path)) for path in _USED)
    passes = () if _interlacing(text) is not None else unread_notes([("EScan/ScanInterlacing", text.text("EScan/ScanInterlacing"))])
    return _two_counts(text) + numbers + passes + unread_switches((path, text.text(path)) for path in _SWITCHES)


def _two_counts(text: FeiText) -> tuple[str, ...]:
    image, scan = text.number("Image/Integrate"), text.number("Scan/Integrate")
    if image is not None and scan is not None and image != scan:
        return (f"[Scan] contains {scan:g} integrated frames and [Image] {image:g}; [Image] is used.",)
    return ()


def _frames_filtered(text: FeiText) -> float | None:
    filtered = "Integration" in text.text("BinaryResult/FilterType")
    return text.number("BinaryResult/FilterFrameCount") if filtered else None


def _acquired(text: FeiText, mtime_ns: int) -> Acquired:
    """Return the first time that is understood, of three that a file may contain."""
    written = text.xml.get("Acquisition/AcquisitionDatetime", "")
    date, _, clock = text.ini.get("PrivateFei/TimeOfCreation", "").partition(" ")
    created = acquired(date, clock, "dmy", mtime_ns)
    user = acquired(text.ini.get("User/Date", ""), text.ini.get("User/Time", ""), "mdy", mtime_ns)
    times = (Acquired(iso(written), written.strip()[:60]), created, user)
    understood = next((time for time in times if time.moment is not None), None)
    return understood or Acquired(unread=next((time.unread for time in times if time.unread), ""))


def _tail_text(data: bytes) -> str | None:
    # Quanta microscopes append the text to the file, outside any tag.
    tail = data[-_TAIL_BYTES:]
    match = re.search(rb"\[User\]\r?\nDate=", tail)
    return None if match is None else tail[match.start() :].split(b"\0", 1)[0].decode("utf-8", errors="replace")


def _local(tag: object) -> str:
    return str(tag).rsplit("}", 1)[-1]
