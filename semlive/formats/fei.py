"""FEI and Thermo Fisher files: the INI text in tag 34682 (Helios) or 34680 (SFEG), the XML in tag 34683, or text after the pixels.

What decides, all read off real files:

- Row time is ``[EScan] LineTime``: fly-back varies from file to file at equal dwell (220 to 520 us per pass), so it is never
  computed from the dwell. LineTime includes all passes of line integration; dwell is that of one pass.
- The scan lasts FrameTime times the frames integrated, ``[Image] Integrate``; ``[Scan] Integrate`` may say 1 beside it.
- The databar is what the file has more than ``[Image] ResolutionY`` rows; ``DatabarHeight`` says 0 in files that have one.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.tiff import Directory, Tag

_MAX_TEXT_BYTES = 2**20
_TAIL_BYTES = 2**18
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
ONE_SECOND_SIGMA_S = 1 / math.sqrt(12)


@dataclass(frozen=True, slots=True)
class FeiHeader:
    """What an FEI file says, as text.

    Attributes:
        ini: value by ``section/key``.
        xml: text by ``parent/element``.
    """

    ini: dict[str, str]
    xml: dict[str, str]

    def text(self, *paths: str) -> str:
        """First non-empty value of the INI paths, else of the XML."""
        for path in paths:
            value = self.ini.get(path) or self.xml.get(path) or ""
            if value:
                return value
        return ""

    def number(self, *paths: str) -> float | None:
        """First value of the paths that is a finite number above zero."""
        for path in paths:
            for source in (self.ini, self.xml):
                try:
                    value = float(source.get(path, ""))
                except ValueError:
                    continue
                if 0 < value < math.inf:
                    return value
        return None


def read_header(data: bytes, directory: Directory) -> FeiHeader | None:
    """The header of an FEI file; None if it is not one."""
    ini = directory.text(data, Tag.FEI_HELIOS) or directory.text(data, Tag.FEI_SFEG) or _tail_text(data)
    xml = directory.text(data, Tag.FEI_XML)
    if not ini and not xml:
        return None
    return FeiHeader(parse_ini(ini or ""), parse_xml(xml or ""))


def parse_ini(text: str) -> dict[str, str]:
    """Values by ``section/key``; the last of equal keys counts."""
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
    """Texts by ``parent/element``, names without namespace; the first of equal paths counts. Empty if it is not XML."""
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


def frame_info(file: ExportedFile, header: FeiHeader, width: int, rows: int, profile: ScanProfile) -> FrameInfo:
    """Everything an FEI file says of its frame.

    Args:
        file: the exported file.
        header: its header.
        width: columns of the image.
        rows: rows of the image, databar included.
        profile: fills what the file does not say.

    Raises:
        BadImage: it is no plain electron scan, its values contradict each other, or one is missing everywhere.
    """
    _refuse_processed(file.name, header)
    height = _height(file.name, header, width, rows, profile)
    timing = _timing(file.name, header, width, height, profile)
    start, sigma_s = _start(file.name, header, timing, profile)
    pixel = header.number("EScan/PixelWidth", "Scan/PixelWidth", "PixelSize/X")
    return FrameInfo(
        export=file.export,
        name=file.name,
        vendor="fei",
        width_px=width,
        height_px=height,
        databar_rows=rows - height,
        timing=timing,
        start_time_ns=start,
        start_sigma_s=sigma_s,
        pixel_size_m=_sourced(file.name, "pixel size", "pixel_size_m", pixel, profile.pixel_size_m, 1.0),
    )


def _refuse_processed(name: str, header: FeiHeader) -> None:
    beam = header.text("Beam/Beam")
    scanned = header.number("EScan/Dwell", "Scan/Dwelltime", "ScanSettings/DwellTime", "EScan/LineTime")
    if scanned is None and beam and beam != "EBeam":
        raise BadImage(f"{name}: was not scanned with the electron beam ([Beam] Beam={beam[:20]}); export the electron image.")
    if header.text("Image/DriftCorrected").lower() in ("on", "yes", "true"):
        raise BadImage(f"{name}: the microscope already corrected drift (DriftCorrected=On); switch drift-corrected integration off.")
    if (header.number("Image/Average", "EScan/Average", "Scan/Average") or 0) > 1:
        raise BadImage(f"{name}: is a running average of frames, so its pixels have no scan time; integrate instead of averaging.")
    if (header.number("EScan/ScanInterlacing") or 1) > 1:
        raise BadImage(f"{name}: was scanned interlaced, so its rows were not written in order; switch interlacing off.")


def _height(name: str, header: FeiHeader, width: int, rows: int, profile: ScanProfile) -> int:
    said_width = header.number("Image/ResolutionX")
    said_height = header.number("Image/ResolutionY")
    if said_width is not None and said_width != width:
        raise BadImage(f"{name}: is {width} px wide but its header says {said_width:g}; export it unscaled.")
    height = said_height if said_height is not None else rows - (profile.databar_rows or 0)
    if not 1 <= height <= rows or height != int(height):
        raise BadImage(f"{name}: has {rows} rows but its header says {height:g}; export it uncropped.")
    return int(height)


def _timing(name: str, header: FeiHeader, width: int, height: int, profile: ScanProfile) -> ScanTiming:
    dwell = header.number("EScan/Dwell", "Scan/Dwelltime", "ScanSettings/DwellTime")
    row = header.number("EScan/LineTime", "ScanSettings/LineTime")
    frame = header.number("EScan/FrameTime", "Scan/FrameTime", "ScanSettings/FrameTime")
    integrations = header.number("Image/Integrate", "EScan/Integrate", "Scan/Integrate")
    passes = header.number("EScan/LineIntegration") or 1.0
    timing = ScanTiming(
        dwell_time_s=_sourced(name, "dwell time", "dwell_time_s", dwell, profile.dwell_time_s, 10.0),
        row_time_s=_sourced(name, "row time", "row_time_s", row, profile.row_time_s, 1e4),
        frame_time_s=_sourced(name, "frame time", "frame_time_s", frame, profile.frame_time_s, 1e6),
        integrations=Sourced(1, Provenance.ASSUMED) if integrations is None else Sourced(_count(name, integrations), Provenance.FILE),
    )
    # A small allowance: the files print six digits.
    if timing.row_time_s.value * 1.00001 < passes * width * timing.dwell_time_s.value:
        raise BadImage(
            f"{name}: its row time of {timing.row_time_s.value:g} s is shorter than {passes:g} x {width} px at its dwell time of "
            f"{timing.dwell_time_s.value:g} s; export it unscaled."
        )
    if timing.frame_time_s.value * 1.00001 < height * timing.row_time_s.value:
        raise BadImage(
            f"{name}: its frame time of {timing.frame_time_s.value:g} s is shorter than {height} rows of "
            f"{timing.row_time_s.value:g} s; export it uncropped."
        )
    return timing


def _count(name: str, number: float) -> int:
    if number != int(number) or number > 10_000:
        raise BadImage(f"{name}: says that {number:g} frames were integrated; export it again.")
    return int(number)


def _sourced(name: str, what: str, key: str, said: float | None, configured: float | None, most: float) -> Sourced[float]:
    value = said if said is not None else configured
    if value is None:
        raise BadImage(f"{name}: does not say its {what}; set scan.{key} in the configuration.")
    if not 0 < value <= most:
        raise BadImage(f"{name}: its {what} of {value:g} cannot be; export it again or set scan.{key}.")
    return Sourced(value, Provenance.CONFIG if said is None else Provenance.FILE)


def _start(name: str, header: FeiHeader, timing: ScanTiming, profile: ScanProfile) -> tuple[Sourced[int], float]:
    """Start of the scan and its standard uncertainty from the embedded time, which marks what the profile says.

    A time printed in whole seconds was cut, not rounded: it stands for its middle, +- 1 s / sqrt(12). The clock of
    the microscope is taken as UTC unless the file names a zone.
    """
    embedded = _parse_iso(header.xml.get("Acquisition/AcquisitionDatetime", ""))
    embedded = embedded or _parse_created(header.ini.get("PrivateFei/TimeOfCreation", ""))
    embedded = embedded or _parse_user(header.ini.get("User/Date", ""), header.ini.get("User/Time", ""))
    if embedded is None:
        raise BadImage(f"{name}: has no readable time of acquisition; switch the date and time of the export on.")
    instant, whole_seconds = embedded
    time_ns = (instant - _EPOCH) // timedelta(microseconds=1) * 1000 + (500_000_000 if whole_seconds else 0)
    sigma_s = max(profile.start_sigma_s, ONE_SECOND_SIGMA_S) if whole_seconds else profile.start_sigma_s
    if profile.start_anchor == "start":
        return Sourced(time_ns, Provenance.FILE), sigma_s
    return Sourced(time_ns - round(timing.duration_s * 1e9), Provenance.DERIVED), sigma_s


def _parse_iso(text: str) -> tuple[datetime, bool] | None:
    try:
        return _believed(datetime.fromisoformat(text), whole_seconds="." not in text)
    except (ValueError, OverflowError):
        return None


def _parse_created(text: str) -> tuple[datetime, bool] | None:
    try:
        return _believed(datetime.strptime(text, "%d.%m.%Y %H:%M:%S"), whole_seconds=True)
    except (ValueError, OverflowError):
        return None


def _parse_user(date: str, time: str) -> tuple[datetime, bool] | None:
    for form in ("%m/%d/%Y %I:%M:%S %p", "%m/%d/%Y %H:%M:%S"):
        try:
            return _believed(datetime.strptime(f"{date} {time}", form), whole_seconds=True)
        except (ValueError, OverflowError):
            continue
    return None


def _believed(instant: datetime, whole_seconds: bool) -> tuple[datetime, bool] | None:
    aware = instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant.astimezone(UTC)
    return (aware, whole_seconds) if 1980 <= aware.year < 2200 else None


def _tail_text(data: bytes) -> str | None:
    # Quanta microscopes append the text to the file, outside any tag.
    tail = data[-_TAIL_BYTES:]
    found = re.search(rb"\[User\]\r?\nDate=", tail)
    return None if found is None else tail[found.start() :].split(b"\0", 1)[0].decode("utf-8", errors="replace")


def _local(tag: object) -> str:
    return str(tag).rsplit("}", 1)[-1]
