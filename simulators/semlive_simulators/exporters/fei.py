"""FEI and Thermo Fisher: metadata in tags 34682 (INI text) and 34683 (XML), databar below the image.

Layout and keys (one strip per row, IFD after the pixels, three-digit exponents, CRLF) are those of files of FEI microscopes. The
embedded times are those of the end of the scan: tag 34682 has a resolution of 1 s, as in all files; tag 34683 has fractions of a second in
AcquisitionDatetime, as in newer software. No time zone is written: the microscope PC uses UTC.
"""

from __future__ import annotations

from semlive_simulators.exporters import databar, tiff
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata, Pixels


def fei_text(facts: ImageMetadata, databar_rows: int) -> str:
    """The INI text of tag 34682."""
    scan, end = facts.scan, facts.end_time
    pixel_m = _fei(scan.pixel_size_um / 1e6)
    width_m, height_m = _fei(scan.width_px * scan.pixel_size_um / 1e6), _fei(scan.height_px * scan.pixel_size_um / 1e6)
    size = {"PixelWidth": pixel_m, "PixelHeight": pixel_m, "HorFieldsize": width_m, "VerFieldsize": height_m}
    stage = {"StageX": _fei(facts.stage_x_um * 1e-6), "StageY": _fei(facts.stage_y_um * 1e-6), "StageZ": "0.01", "StageR": "0"}
    shift = {"BeamShiftX": _fei(facts.beam_x_um * 1e-6), "BeamShiftY": _fei(facts.beam_y_um * 1e-6)}
    dwell, frame_time = _fei(scan.dwell_time_s), repr(facts.frame_time_s)
    sections: dict[str, dict[str, object]] = {
        "User": {"Date": f"{end:%m/%d/%Y}", "Time": f"{end:%I:%M:%S %p}", "User": "supervisor", "UserText": "", "UserTextUnicode": ""},
        "System": {"Type": "SEM", "Dnumber": "SIM0200", "Software": "4.1.7.2114", "Source": "Tungsten", "Column": "virtual",
                   "Scan": "PIA 3.0", "Acq": "PIA 3.0", "SystemType": "Virtual Quanta 200"},
        "Beam": {"HV": 30000, "Spot": 5, **shift, "ScanRotation": _fei(scan.rotation_rad), "ImageMode": "Normal",
                 "Beam": "EBeam", "Scan": "EScan"},
        "EBeam": {"Source": "Tungsten", "HV": 30000, "HFW": width_m, "VFW": height_m, "WD": "0.01", **stage, **shift},
        "Scan": {"InternalScan": "true", "Dwelltime": dwell, **size, "Average": 0, "Integrate": 1, "FrameTime": frame_time},
        "EScan": {"Scan": "PIA 3.0", "InternalScan": "true", "Dwell": dwell, **size, "FrameTime": frame_time,
                  "LineTime": repr(facts.line_time_s), "Mainslock": "Off", "LineIntegration": facts.lines_integrated, "ScanInterlacing": 1},
        "Stage": {**stage, "StageT": 0, "WorkingDistance": "0.01"},
        "Image": {"DigitalContrast": 1, "DigitalBrightness": 0, "DigitalGamma": 1, "Average": 0, "Integrate": facts.frames_integrated,
                  "ResolutionX": scan.width_px, "ResolutionY": scan.height_px, "DriftCorrected": "Off", "ZoomFactor": "1.0",
                  "PostProcessing": "None", "Transformation": "None"},
        "Vacuum": {"ChPressure": "0.00024", "Gas": "", "UserMode": "High vacuum", "Humidity": ""},
        "Detectors": {"Number": 1, "Name": "BSED", "Mode": "BSE"},
        "PrivateFei": {"BitShift": 0, "DataBarSelected": "HV mag HFW det WD DateTime dwell Label MicronBar",
                       "TimeOfCreation": f"{end:%d.%m.%Y %H:%M:%S}", "DatabarHeight": databar_rows},
    }  # fmt: skip
    blocks = ["\r\n".join([f"[{name}]", *(f"{key}={value}" for key, value in keys.items()), ""]) for name, keys in sections.items()]
    return "\r\n".join(blocks)


def fei_xml(facts: ImageMetadata) -> str:
    """The XML of tag 34683."""
    scan = facts.scan
    pixel_m = repr(scan.pixel_size_um / 1e6)
    return (
        '<?xml version="1.0"?>\r\n<Metadata><Core><ApplicationSoftware>xT</ApplicationSoftware></Core>'
        f"<Acquisition><AcquisitionDatetime>{facts.end_time:%Y-%m-%dT%H:%M:%S.%f}</AcquisitionDatetime>"
        "<BeamType>Electron</BeamType></Acquisition>"
        f'<BinaryResult><PixelSize><X unit="m">{pixel_m}</X><Y unit="m">{pixel_m}</Y></PixelSize></BinaryResult>'
        f"<ScanSettings><DwellTime>{scan.dwell_time_s!r}</DwellTime><LineTime>{facts.line_time_s!r}</LineTime>"
        f"<FrameTime>{facts.frame_time_s!r}</FrameTime><LineIntegrationCount>{facts.lines_integrated}</LineIntegrationCount>"
        f"<ScanSize><Width>{scan.width_px}</Width><Height>{scan.height_px}</Height></ScanSize></ScanSettings></Metadata>\r\n"
    )


def _fei(value: float) -> str:
    """A number in the format of FEI: short, with three digits in the exponent."""
    mantissa, mark, exponent = f"{value:.10g}".partition("e")
    return f"{mantissa}e{int(exponent):+04d}" if mark else mantissa


def encode_tiff(image: Pixels, facts: ImageMetadata, databar_rows: int) -> bytes:
    """A complete file: header, pixels and databar, then the directory and its values."""
    pixels = databar.appended(image, facts, databar_rows)
    height, width = pixels.shape
    entries = [
        tiff.shorts(256, width),
        tiff.shorts(257, height),
        tiff.shorts(258, 8 * pixels.itemsize),
        tiff.shorts(259, 1),
        tiff.shorts(262, 1),
        tiff.shorts(277, 1),
        tiff.shorts(278, 1),
        tiff.rational(282, 192, 1),
        tiff.rational(283, 192, 1),
        tiff.shorts(284, 1),
        tiff.shorts(296, 2),
        tiff.text(34682, fei_text(facts, databar_rows)),
        tiff.text(34683, fei_xml(facts)),
    ]
    return tiff.file_bytes(tiff.row_strips(pixels, 1), entries, directory_first=False)


def encode(image: Pixels, facts: ImageMetadata, databar_rows: int) -> EncodedFrame:
    """A frame as FEI software exports it."""
    return EncodedFrame(encode_tiff(image, facts, databar_rows))
