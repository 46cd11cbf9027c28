"""Settings of the scan that change geometry: read from the header of each vendor, and compared between frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from semlive.data.frame import ExportedFile
from semlive.data.scan import FULL_FRAME, Provenance, ScanGeometry, Sourced, geometry_difference, geometry_notes
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images.frame_metadata import frame_info
from semlive.formats.log.conversions import frame_info as logged_info
from semlive.formats.log.conversions import scan_message
from semlive.formats.log.messages.frames import ScanMessage
from semlive.formats.metadata.header import Header
from semlive.formats.vendors import fei, hitachi, jeol, tescan, zeiss

FILE = ExportedFile(0, "a.tif", b"", "", 1, 1)
# The values are those of public headers: see the docstring of each vendor module.
FEI = {
    "EBeam/TiltCorrectionIsOn": "no",
    "EBeam/DynamicFocusIsOn": "no",
    "EBeam/DynamicWDIsOn": "",
    "EBeam/TiltCorrectionAngle": "-0.663242",
    "EBeam/LensMode": "Field-Free",
    "EBeam/MagnificationCorrection": "Off",
    "EScan/Dwell": "3e-05",
    "EScan/PixelWidth": "1e-08",
    "EScan/PixelHeight": "1e-08",
    "EScan/HorFieldsize": "3.072E-05",
    "EScan/VerFieldsize": "2.048E-05",
    "EScan/LineTime": "0.1",
    "EScan/FrameTime": "205",
    "EScan/ScanInterlacing": "1",
    "Image/ResolutionX": "3072",
    "Image/ResolutionY": "2048",
    "Image/ZoomFactor": "1.0",
    "Image/DriftCorrected": "Off",
    "User/Date": "10/09/2023",
    "User/Time": "08:04:59 PM",
}
ZEISS = {
    "AP_LINE_TIME": "Line Time = 4.0 ms",
    "DP_TILT_CORRECTION": "Tilt Corrn. = Off",
    "AP_TILT_ANGLE": "Tilt Angle =  45.0 °",
    "DP_DYNFOCUS": "Dyn.Focus = Off",
    "DP_ZOOM": "Zoom = Off",
    "AP_ZOOM_FACTOR": "Zoom factor =  2.000",
    "DP_FIELD_MODE": "Field Mode = Off",
    "DP_NOISE_REDUCTION": "Noise Reduction = Line Avg",
    "AP_WIDTH": "Width = 607.5 µm",
    "AP_HEIGHT": "Height = 455.6 µm",
    "AP_IMAGE_PIXEL_SIZE": "Image Pixel Size = 593.3 nm",
}
TESCAN = {"PixelSizeX": "2.5e-6", "PixelSizeY": "2.5e-6", "TiltCorrection": "0.0", "ScanMode": "WIDE FIELD", "ImageStripSize": "120"}
JEOL = {"$CM_FULL_SIZE": "1280 960", "$$SM_COLUMN_MODE": "SEM", "$$CM_SCAN_MODE": "2", "$$SM_IMAGE_INTEGRATION_TYPE": "0"}
HITACHI = {"PixelSize": "506.25", "DataSize": "1280x1100", "DigitalZoom": "No", "LensMode": "Normal"}


def of_fei(**changes: str) -> Header:
    values = FEI | {key.replace("_", "/", 1): value for key, value in changes.items()}
    return fei.header(fei.FeiText(values, {}), 3072, 2048)


def of_zeiss(**changes: str) -> Header:
    lines = [word for pair in (ZEISS | changes).items() for word in pair]
    return zeiss.header(zeiss.parse("\r\n".join(["0", *lines, ""])), 1024, 768)


def of_tescan(**changes: str) -> Header:
    return tescan.header(TESCAN | changes)


def of_jeol(**changes: str) -> Header:
    return jeol.header(JEOL | {f"$${key}": value for key, value in changes.items()})


def of_hitachi(**changes: str) -> Header:
    return hitachi.header(HITACHI | changes, 0)


@pytest.mark.parametrize(
    ("vendor", "change", "clause"),
    [
        (of_fei, {"EBeam_TiltCorrectionIsOn": "yes"}, "tilt correction on instead of off"),
        (of_fei, {"EBeam_DynamicFocusIsOn": "yes"}, "dynamic focus on instead of off"),
        (of_fei, {"EBeam_DynamicWDIsOn": "yes"}, "dynamic focus on instead of off"),
        (of_fei, {"EScan_PixelHeight": "1.3e-08", "EScan_VerFieldsize": "2.6624e-05"}, "pixel height 1.3e-08 m instead of 1e-08 m"),
        (of_fei, {"Image_ZoomFactor": "2.000000"}, "zoom 2x instead of 1x"),
        (of_fei, {"EScan_ScanInterlacing": "4"}, "interlacing 4 instead of 1"),
        (of_fei, {"Image_DriftCorrected": "On"}, "drift correction on instead of off"),
        (of_fei, {"EBeam_LensMode": "Immersion"}, "scan mode Immersion instead of Field-Free"),
        (of_fei, {"EBeam_MagnificationCorrection": "On"}, "scan mode Field-Free, MagnificationCorrection instead of Field-Free"),
        (of_zeiss, {"DP_TILT_CORRECTION": "Tilt Corrn. = On"}, "tilt correction on instead of off"),
        (of_zeiss, {"DP_DYNFOCUS": "Dyn.Focus = On"}, "dynamic focus on instead of off"),
        (of_zeiss, {"DP_ZOOM": "Zoom = On"}, "zoom 2x instead of 1x"),
        (of_zeiss, {"DP_FIELD_MODE": "Field Mode = On"}, "scan mode field mode instead of normal"),
        (of_zeiss, {"AP_HEIGHT": "Height = 768.0 µm"}, "pixel height 1e-06 m instead of 5.933e-07 m"),
        (of_zeiss, {"DP_NOISE_REDUCTION": "Noise Reduction = Drift Corr. Frame Avg."}, "drift correction on instead of off"),
        (of_tescan, {"TiltCorrection": "30.0"}, "tilt correction on instead of off"),
        (of_tescan, {"PixelSizeY": "3.0e-6"}, "pixel height 3e-06 m instead of 2.5e-06 m"),
        (of_tescan, {"ScanMode": "RESOLUTION"}, "scan mode RESOLUTION instead of WIDE FIELD"),
        (of_jeol, {"CM_SCAN_MODE": "3"}, "column SEM, scan 3, integration 0 instead of column SEM, scan 2, integration 0"),
        (of_fei, {"EBeam_TiltCorrectionIsOn": "1"}, "tilt correction on instead of off"),
        (of_fei, {"EScan_ScanInterlacing": "On"}, "interlacing 2 instead of 1"),
        (of_tescan, {"TiltCorrection": "On"}, "tilt correction on instead of off"),
        (of_hitachi, {"DigitalZoom": "x2"}, "zoom 2x instead of 1x"),
        (of_hitachi, {"DigitalZoom": "Yes"}, "scan mode Normal, digital zoom instead of Normal"),
    ],
)
def test_each_setting_of_each_vendor_separates_frames(vendor: Callable[..., Header], change: dict[str, str], clause: str) -> None:
    before, after = vendor().geometry, vendor(**change).geometry
    assert geometry_difference(before, before) is None
    assert clause in (geometry_difference(before, after) or "")


@pytest.mark.parametrize(
    ("vendor", "key"),
    [(of_tescan, "DynamicFocus"), (of_tescan, "LineAccumulation"), (of_jeol, "SM_TILT_CORRECTION"), (of_hitachi, "ReducedArea")],
)
def test_a_key_about_geometry_that_no_public_file_has_is_compared_as_it_is(vendor: Callable[..., Header], key: str) -> None:
    difference = geometry_difference(vendor(**{key: "1"}).geometry, vendor(**{key: "2"}).geometry)
    assert difference is not None
    assert f"{key} 2" in difference


@pytest.mark.parametrize(
    ("vendor", "key", "word"),
    [
        (of_fei, "EBeam_TiltCorrectionIsOn", "partly"),
        (of_fei, "EScan_ScanInterlacing", "alternating"),
        (of_zeiss, "DP_DYNFOCUS", "Dyn.Focus = partly"),
        (of_tescan, "TiltCorrection", "steep"),
    ],
)
def test_a_setting_that_is_not_understood_is_noted(vendor: Callable[..., Header], key: str, word: str) -> None:
    assert vendor().notes == ()
    [note] = vendor(**{key: word}).notes
    assert f"{word.rpartition('= ')[2]!r} was not understood" in note


def test_two_angles_of_tilt_correction_differ_and_those_of_a_switch_that_is_off_do_not() -> None:
    on = of_fei(EBeam_TiltCorrectionIsOn="yes").geometry
    steeper = of_fei(EBeam_TiltCorrectionIsOn="yes", EBeam_TiltCorrectionAngle="-0.9").geometry
    assert geometry_difference(on, steeper) == "tilt correction angle -51.5662 degrees instead of -38.001 degrees"
    assert geometry_difference(of_fei().geometry, of_fei(EBeam_TiltCorrectionAngle="0.1").geometry) is None


def test_a_setting_that_one_file_lacks_is_ignored() -> None:
    assert geometry_difference(ScanGeometry(), of_fei().geometry) is None
    assert geometry_difference(of_fei().geometry, ScanGeometry()) is None


def test_the_settings_of_one_frame_are_explained() -> None:
    header = of_fei(EBeam_TiltCorrectionIsOn="yes", EBeam_DynamicFocusIsOn="yes")
    notes = geometry_notes(replace(header.geometry, pixel_height_m=Sourced(1.3e-8, Provenance.FILE)), 1e-8)
    assert [words in note for words, note in zip(("not square", "tilt correction is on", "dynamic focus is on"), notes, strict=True)] == [
        True
    ] * 3
    assert geometry_notes(of_fei().geometry, 1.0005e-8) == ()


def test_the_log_keeps_the_settings() -> None:
    info = frame_info(FILE, of_fei(EBeam_TiltCorrectionIsOn="yes"), 3072, 2048, ScanProfile())
    assert info.geometry.tilt_correction == Sourced(True, Provenance.FILE)
    message = ScanMessage.model_validate_json(scan_message(info).model_dump_json())
    assert logged_info(message).geometry == info.geometry


REDUCED = FEI | {
    "EScan/HorFieldsize": "2.243E-05",
    "EScan/VerFieldsize": "1.088E-05",
    "EScan/LineTime": "0.06816",
    "EScan/FrameTime": "74.1581",
}


@pytest.mark.parametrize("databar", [0, 68])
def test_a_reduced_area_of_fei_is_accepted_with_its_own_size(databar: int) -> None:
    info = frame_info(FILE, fei.header(fei.FeiText(REDUCED, {}), 2243, 1088 + databar), 2243, 1088 + databar, ScanProfile())
    assert (info.width_px, info.height_px, info.databar_rows) == (2243, 1088, databar)
    assert info.geometry.area == Sourced("2243 x 1088 of 3072 x 2048 px", Provenance.FILE)
    assert geometry_difference(of_fei().geometry, info.geometry) == f"scan area 2243 x 1088 of 3072 x 2048 px instead of {FULL_FRAME}"


@pytest.mark.parametrize("size", [(3072, 2048), (1121, 544)], ids=["pasted into the full frame", "scaled"])
def test_a_reduced_area_of_another_size_is_refused_by_name(size: tuple[int, int]) -> None:
    with pytest.raises(
        BadImage, match=r"only a reduced area of 2243 x 1088 of 3072 x 2048 px was scanned, but it has \d+ x \d+ px"
    ) as refused:
        frame_info(FILE, fei.header(fei.FeiText(REDUCED, {}), *size), *size, ScanProfile())
    assert "its header contains" not in str(refused.value)


def test_a_scaled_full_frame_of_fei_is_still_refused() -> None:
    with pytest.raises(BadImage, match="is 1536 px wide but its header contains 3072; export it unscaled"):
        frame_info(FILE, fei.header(fei.FeiText(FEI, {}), 1536, 1024), 1536, 1024, ScanProfile())


def test_the_area_in_xml_text_is_read_with_its_place() -> None:
    xml = """<Metadata><ScanSettings><ScanSize><Width>2048</Width><Height>1768</Height></ScanSize><ScanArea><X>100</X><Y>50</Y>
    <Width>800</Width><Height>600</Height></ScanArea><LineInterlacing>1</LineInterlacing></ScanSettings>
    <Optics><SampleTiltCorrectionOn>true</SampleTiltCorrectionOn><SamplePreTiltAngle>-0.663225</SamplePreTiltAngle></Optics></Metadata>"""
    geometry = fei.header(fei.FeiText({}, fei.parse_xml(xml)), 800, 600).geometry
    assert geometry.values() == {
        "tilt_correction": True,
        "tilt_correction_deg": pytest.approx(-38.0, abs=0.01),
        "area": "800 x 600 of 2048 x 1768 px from (100, 50)",
        "interlacing": 1,
    }


def test_drift_corrected_accumulation_of_tescan_is_refused() -> None:
    assert "already corrected drift" in str(of_tescan(AccType="Drift corrected").refused)
    assert of_tescan(AccType="LINE").refused is None
