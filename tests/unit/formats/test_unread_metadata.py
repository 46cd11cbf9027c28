"""Metadata that exist but are not understood are reported; numbers and units of other locales and code pages are read."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.formats import check_finished
from semlive.formats.images.frame_metadata import fill_missing, missing_metadata_message
from semlive.formats.images.inspection import inspect_file
from semlive.formats.metadata.key_value import decode_text
from semlive.formats.metadata.quantity import number, quantity
from semlive.formats.vendors import hitachi, jeol, tescan

PROFILE = ScanProfile(dwell_time_s=1e-6, row_time_s=1e-3, pixel_size_m=1e-8)


def exported(sidecar: bytes | None = None, tag: tuple[int, bytes] | None = None) -> ExportedFile:
    image = np.random.default_rng(0).integers(20, 230, (88, 102), dtype=np.uint8)
    stream = io.BytesIO()
    extra = [] if tag is None else [(tag[0], "B", len(tag[1]), tag[1], True)]
    tifffile.imwrite(stream, image, extratags=extra, metadata=None)
    return ExportedFile(0, "a.tif", stream.getvalue(), "", 10**18, 10**18, sidecar)


@pytest.mark.parametrize(("code", "vendor"), [(34682, "fei"), (34680, "fei"), (34118, "zeiss"), (50431, "tescan")])
def test_an_unreadable_tag_of_a_vendor_is_noted(code: int, vendor: str) -> None:
    notes = inspect_file(exported(tag=(code, bytes(range(1, 200)))), PROFILE).notes
    assert f"its metadata in tag {code} of {vendor} cannot be read; export it again, or copy the original file." in notes


@pytest.mark.parametrize(("code", "program"), [(65009, "DigitalMicrograph of Gatan"), (33560, "an Olympus program (SIS)")])
def test_private_tags_of_other_programs_are_noted(code: int, program: str) -> None:
    notes = inspect_file(exported(tag=(code, bytes(8))), PROFILE).notes
    assert notes == (f"its metadata of {program} are not read; state its pixel size and times in sem.profile.",)


HITACHI = b"InstructName=SU8000\r\nDataSize=1280x960\r\nScanSpeed=Slow3\r\nPixelSize="


@pytest.mark.parametrize(
    ("text", "pixel_nm"),
    [
        ("1,984\r\nDPI=200.69", 1984.0),
        ("1,984\r\nDPI=200,69", 1.984),
        ("1,984\r\nMagnification=50000", 1.984),
        ("1,984\r\nMagnification=50", 1984.0),
        ("1.984", 1.984),
        ("1.984\r\nDPI=200,69", 1984.0),
        ("1.98 nm", 1.98),
        ("1'984", 1984.0),
        ("1\u2019984.5\r\nMagnification=50", 1984.5),
        ("1,984", None),
        ("1,984\r\nMagnification=50\r\nDPI=200,69", None),
        ("1.984\r\nMagnification=50", None),
    ],
)
def test_thousands_in_a_pixel_size_are_decided_by_the_other_numbers(text: str, pixel_nm: float | None) -> None:
    header = hitachi.read_sidecar(HITACHI + text.encode("cp1252"), 0)
    assert header is not None
    assert (header.pixel_size_m and header.pixel_size_m.value) == (pytest.approx(pixel_nm * 1e-9) if pixel_nm else None)
    if pixel_nm is None:
        problem = f"its PixelSize {text[:5]!r} may be 1.984 or 1984 nm"
        assert f"{problem}." in header.notes
        timed = replace(PROFILE, pixel_size_m=None, databar_rows=0)
        shown = replace(header, width_px=None, rows=None)
        assert missing_metadata_message("a.tif", shown, 102, fill_missing("a.tif", shown, 102, 88, timed)) == (
            f"a.tif: {problem}; set sem.profile.pixel_size_m"
            + (", or sem.profile.field_width_mm_at_1x for its magnification 50" if "50" in text else "")
            + " in the configuration."
        )


def test_the_text_of_a_tag_may_be_utf_16() -> None:
    text = "[User]\r\nDate=03/14/2022\r\nTime=11:52:46\r\n[EScan]\r\nDwell=2e-06\r\n"
    assert inspect_file(exported(tag=(34682, text.encode("utf-16-le"))), PROFILE).values["dwell_time_s"].value == 2e-6


def test_a_file_without_tags_of_a_vendor_has_no_note() -> None:
    assert inspect_file(exported(), PROFILE).notes == ()


def test_a_text_file_of_no_vendor_is_noted() -> None:
    [note] = inspect_file(exported(b"dear diary\r\n"), PROFILE).notes
    assert "is not that of a known microscope" in note


@pytest.mark.parametrize("text", ["3.2e-06", "3,2e-06", "0,0000032", " 0,000003200 "])
def test_a_decimal_comma_of_a_header_is_read(text: str) -> None:
    assert number(text) == pytest.approx(3.2e-6, rel=1e-12)


@pytest.mark.parametrize("text", ["1,024", "1_000", "1.024,5", "nan", "inf", "three"])
def test_a_number_with_two_meanings_is_none(text: str) -> None:
    assert number(text) is None


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252", "cp932", "gb18030", "cp949"])
def test_micrometres_are_read_in_any_code_page(encoding: str) -> None:
    text = "$$SM_MICRON_MARKER 100μm".replace("μ", "µ" if encoding == "cp1252" else "μ").encode(encoding)
    found = quantity(decode_text(text).split()[1])
    assert found is not None
    assert found.value == pytest.approx(1e-4)


def test_units_that_are_unknown_stay_unknown() -> None:
    assert quantity("100 foot") is None
    found = quantity("100 nm")
    assert found is not None
    assert found.value == pytest.approx(1e-7)


def test_a_number_that_is_not_understood_is_noted() -> None:
    text = b"Device=MIRA3\r\nPixelSizeX=1,024\r\nDwellTime=soon\r\nImageStripSize=0\r\n"
    header = tescan.read_sidecar(text)
    assert header is not None
    assert (header.dwell_time_s, header.pixel_size_m) == (None, None)
    assert [note for note in header.notes if "was not understood" in note] == [
        "its PixelSizeX '1,024' was not understood.", "its DwellTime 'soon' was not understood.",
    ]  # fmt: skip
    jeol_header = jeol.read_sidecar(b"$CM_FORMAT JEOL/EO\r\n$$SM_MICRON_BAR 53\r\n$$SM_MICRON_MARKER 100 parsec\r\n")
    assert jeol_header is not None
    assert "its $$SM_MICRON_MARKER '100 parsec' was not understood." in jeol_header.notes


def test_inspect_predicts_that_a_run_refuses_another_vendor() -> None:
    [problem] = inspect_file(exported(), PROFILE, "jeol").problems
    assert problem.startswith("it has no header of jeol in a text file of the same name, which sem.vendor requires")
    assert check_finished(exported(), PROFILE, "jeol") == problem.partition(",")[0]
    assert inspect_file(exported(), PROFILE, "plain").problems == ()


@pytest.mark.parametrize(("data", "name"), [(b"\xff\xd8\xff\xe0", "JPEG"), (b"BM12", "BMP"), (b"GIF89a", "GIF")])
def test_the_format_of_an_image_that_a_run_does_not_take_is_named(data: bytes, name: str) -> None:
    file = ExportedFile(0, "a.tif", data + bytes(100), "", 10**18, 10**18)
    [problem] = inspect_file(file, PROFILE).problems
    assert problem == f"is a {name} file, so it is neither TIFF nor PNG; set the microscope's export to TIFF."
