"""Images as the instrument's TIFF files: FEI metadata in tags 34682 (INI text) and 34683 (XML), databar below the image.

Layout, keys and quirks (one strip a row, IFD behind the pixels, three-digit exponents, CRLF) are those of files that FEI
microscopes wrote. The embedded times mark the end of the scan. Tag 34682 has them to the second, as everywhere; tag 34683
carries fractions of a second in AcquisitionDatetime, as newer software does. No zone is written: the microscope's PC runs on UTC.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive_simulators.column import Scan

_SHORT, _LONG, _RATIONAL, _ASCII = 3, 4, 5, 2
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class ImageFacts:
    """What the instrument writes beside the pixels.

    Attributes:
        scan: the raster.
        end_time_ns: when the scan ended, UTC ns.
        stage_x_um: stage position by its own encoder.
        stage_y_um: likewise.
        frame: number of the frame.
    """

    scan: Scan
    end_time_ns: int
    stage_x_um: float
    stage_y_um: float
    frame: int

    @property
    def end_time(self) -> datetime:
        """End of the scan to the microsecond."""
        return _EPOCH + timedelta(microseconds=self.end_time_ns // 1000)


def fei_text(facts: ImageFacts, databar_rows: int) -> str:
    """The INI text of tag 34682."""
    scan, end = facts.scan, facts.end_time
    pixel_m = _fei(scan.pixel_size_um / 1e6)
    width_m, height_m = _fei(scan.width_px * scan.pixel_size_um / 1e6), _fei(scan.height_px * scan.pixel_size_um / 1e6)
    size = {"PixelWidth": pixel_m, "PixelHeight": pixel_m, "HorFieldsize": width_m, "VerFieldsize": height_m}
    stage = {"StageX": _fei(facts.stage_x_um * 1e-6), "StageY": _fei(facts.stage_y_um * 1e-6), "StageZ": "0.01", "StageR": "0"}
    dwell, frame_time = _fei(scan.dwell_time_s), repr(scan.frame_time_s)
    sections: dict[str, dict[str, object]] = {
        "User": {"Date": f"{end:%m/%d/%Y}", "Time": f"{end:%I:%M:%S %p}", "User": "supervisor", "UserText": "", "UserTextUnicode": ""},
        "System": {"Type": "SEM", "Dnumber": "SIM0200", "Software": "4.1.7.2114", "Source": "Tungsten", "Column": "virtual",
                   "Scan": "PIA 3.0", "Acq": "PIA 3.0", "SystemType": "Virtual Quanta 200"},
        "Beam": {"HV": 30000, "Spot": 5, "BeamShiftX": 0, "BeamShiftY": 0, "ScanRotation": 0, "ImageMode": "Normal",
                 "Beam": "EBeam", "Scan": "EScan"},
        "EBeam": {"Source": "Tungsten", "HV": 30000, "HFW": width_m, "VFW": height_m, "WD": "0.01", **stage, "BeamShiftX": 0,
                  "BeamShiftY": 0},
        "Scan": {"InternalScan": "true", "Dwelltime": dwell, **size, "Average": 0, "Integrate": 1, "FrameTime": frame_time},
        "EScan": {"Scan": "PIA 3.0", "InternalScan": "true", "Dwell": dwell, **size, "FrameTime": frame_time,
                  "LineTime": repr(scan.row_time_s), "Mainslock": "Off", "LineIntegration": 1, "ScanInterlacing": 1},
        "Stage": {**stage, "StageT": 0, "WorkingDistance": "0.01"},
        "Image": {"DigitalContrast": 1, "DigitalBrightness": 0, "DigitalGamma": 1, "Average": 0, "Integrate": 1,
                  "ResolutionX": scan.width_px, "ResolutionY": scan.height_px, "DriftCorrected": "Off", "ZoomFactor": "1.0",
                  "PostProcessing": "None", "Transformation": "None"},
        "Vacuum": {"ChPressure": "0.00024", "Gas": "", "UserMode": "High vacuum", "Humidity": ""},
        "Detectors": {"Number": 1, "Name": "BSED", "Mode": "BSE"},
        "PrivateFei": {"BitShift": 0, "DataBarSelected": "HV mag HFW det WD DateTime dwell Label MicronBar",
                       "TimeOfCreation": f"{end:%d.%m.%Y %H:%M:%S}", "DatabarHeight": databar_rows},
    }  # fmt: skip
    blocks = ["\r\n".join([f"[{name}]", *(f"{key}={value}" for key, value in keys.items()), ""]) for name, keys in sections.items()]
    return "\r\n".join(blocks)


def fei_xml(facts: ImageFacts) -> str:
    """The XML of tag 34683."""
    scan = facts.scan
    pixel_m = repr(scan.pixel_size_um / 1e6)
    return (
        '<?xml version="1.0"?>\r\n<Metadata><Core><ApplicationSoftware>xT</ApplicationSoftware></Core>'
        f"<Acquisition><AcquisitionDatetime>{facts.end_time:%Y-%m-%dT%H:%M:%S.%f}</AcquisitionDatetime>"
        "<BeamType>Electron</BeamType></Acquisition>"
        f'<BinaryResult><PixelSize><X unit="m">{pixel_m}</X><Y unit="m">{pixel_m}</Y></PixelSize></BinaryResult>'
        f"<ScanSettings><DwellTime>{scan.dwell_time_s!r}</DwellTime><LineTime>{scan.row_time_s!r}</LineTime>"
        f"<FrameTime>{scan.frame_time_s!r}</FrameTime><LineIntegrationCount>1</LineIntegrationCount>"
        f"<ScanSize><Width>{scan.width_px}</Width><Height>{scan.height_px}</Height></ScanSize></ScanSettings></Metadata>\r\n"
    )


def _fei(value: float) -> str:
    """A number as FEI writes it: short, with three digits in the exponent."""
    mantissa, mark, exponent = f"{value:.10g}".partition("e")
    return f"{mantissa}e{int(exponent):+04d}" if mark else mantissa


def databar(facts: ImageFacts, rows: int) -> NDArray[np.uint8]:
    """The bar below the image, (rows, width): what an operator reads, and a scale bar."""
    scan = facts.scan
    bar = np.full((rows, scan.width_px), 12, dtype=np.uint8)
    if rows < 16:
        return bar
    bar[1, :] = bar[-2, :] = 200
    size = min(rows / 110.0, scan.width_px / 1900.0)
    field_mm = scan.width_px * scan.pixel_size_um * 1e-3
    texts = (
        "30.00 kV",
        f"HFW {field_mm:.2f} mm",
        "BSED",
        f"dwell {scan.dwell_time_s * 1e6:g} us",
        f"{facts.end_time:%m/%d/%Y %I:%M:%S %p}",
    )
    for column, text in zip((0.01, 0.12, 0.27, 0.35, 0.50), texts, strict=True):
        place = (round(column * scan.width_px), round(0.62 * rows))
        cv2.putText(bar, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, 220, 1, cv2.LINE_AA)
    length = round(0.2 * scan.width_px)
    left = round(0.78 * scan.width_px)
    bar[rows // 2 - 1 : rows // 2 + 1, left : left + length] = 220
    bar[rows // 3 : 2 * rows // 3, (left, left + length)] = 220
    return bar


def encode_tiff(image: NDArray[np.uint8], facts: ImageFacts, databar_rows: int) -> bytes:
    """A whole file: header, pixels and databar, then the directory and what it points to."""
    pixels = np.concatenate([image, databar(facts, databar_rows)]) if databar_rows else image
    height, width = pixels.shape
    offsets = [8 + row * width for row in range(height)]
    entries: list[tuple[int, int, int, bytes]] = [
        (256, _SHORT, 1, struct.pack("<H", width)),
        (257, _SHORT, 1, struct.pack("<H", height)),
        (258, _SHORT, 1, struct.pack("<H", 8)),
        (259, _SHORT, 1, struct.pack("<H", 1)),
        (262, _SHORT, 1, struct.pack("<H", 1)),
        (273, _LONG, height, struct.pack(f"<{height}I", *offsets)),
        (277, _SHORT, 1, struct.pack("<H", 1)),
        (278, _SHORT, 1, struct.pack("<H", 1)),
        (279, _LONG, height, struct.pack(f"<{height}I", *([width] * height))),
        (282, _RATIONAL, 1, struct.pack("<II", 192, 1)),
        (283, _RATIONAL, 1, struct.pack("<II", 192, 1)),
        (284, _SHORT, 1, struct.pack("<H", 1)),
        (296, _SHORT, 1, struct.pack("<H", 2)),
        _ascii(34682, fei_text(facts, databar_rows)),
        _ascii(34683, fei_xml(facts)),
    ]
    start = 8 + pixels.size + pixels.size % 2
    place = start + 2 + 12 * len(entries) + 4
    directory, values = bytearray(struct.pack("<H", len(entries))), bytearray()
    for tag, kind, count, data in entries:
        if len(data) <= 4:
            directory += struct.pack("<HHI4s", tag, kind, count, data.ljust(4, b"\0"))
            continue
        directory += struct.pack("<HHII", tag, kind, count, place + len(values))
        values += data + b"\0" * (len(data) % 2)
    body = pixels.tobytes() + b"\0" * (pixels.size % 2)
    return struct.pack("<2sHI", b"II", 42, start) + body + bytes(directory) + struct.pack("<I", 0) + bytes(values)


def _ascii(tag: int, text: str) -> tuple[int, int, int, bytes]:
    data = text.encode("ascii") + b"\0"
    return tag, _ASCII, len(data), data
