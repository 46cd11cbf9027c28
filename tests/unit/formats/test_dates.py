"""Dates of exported files in any order and language: read if they have one meaning, reported by `inspect` otherwise."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import numpy as np
import pytest
import tifffile
from babel import Locale

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images.frames import read_info
from semlive.formats.images.inspection import inspect_file
from semlive.formats.metadata.month_names import MONTH_NAMES, folded, months_named
from semlive.formats.metadata.timestamps import acquired
from semlive.formats.vendors import jeol, zeiss

LANGUAGES = (
    "en",
    "de",
    "fr",
    "es",
    "it",
    "pl",
    "pt",
    "nl",
    "sv",
    "da",
    "nb",
    "fi",
    "cs",
    "sk",
    "hu",
    "ro",
    "tr",
    "hr",
    "sl",
    "ru",
    "uk",
    "el",
)
SAVED_NS = int(datetime(2022, 3, 14, 12, tzinfo=UTC).timestamp()) * 10**9
READ = {
    "day first": ("14/03/2022", "11:52:46", "mdy", "2022-03-14T11:52:46"),
    "ISO": ("2022-03-14", "11:52:46", "mdy", "2022-03-14T11:52:46"),
    "month first": ("03/14/2022", "11:52:46", "dmy", "2022-03-14T11:52:46"),
    "usual order of the vendor": ("03/04/2022", "11:52:46", "mdy", "2022-03-04T11:52:46"),
    "usual order, file copied a year later": ("12/03/2022", "11:52:46", "mdy", "2022-12-03T11:52:46"),
    "German": ("19 Okt 2019", "9:40:32", "dmy", "2019-10-19T09:40:32"),
    "German December": ("19. Dez. 2019", "9:40:32", "dmy", "2019-12-19T09:40:32"),
    "German, UTF-8 as cp1252": ("3 MÃ¤rz 2022", "9:40:32", "dmy", "2022-03-03T09:40:32"),
    "French": ("5 févr. 2022", "11h52m46s", "dmy", "2022-02-05T11:52:46"),
    "French, unknown code page": ("19 d\ufffdc. 2019", "9:40:32", "dmy", "2019-12-19T09:40:32"),
    "French with weekday": ("lundi 14 mars 2022", "9:40:32", "dmy", "2022-03-14T09:40:32"),
    "Spanish": ("19 de octubre de 2019", "3:40:32 p. m.", "dmy", "2019-10-19T15:40:32"),
    "Italian": ("19 gen 2019", "9.40.32", "dmy", "2019-01-19T09:40:32"),
    "Polish": ("19 paź 2019", "9:40:32", "dmy", "2019-10-19T09:40:32"),
    "Polish, central European code page": (
        "19 " + "paź".encode("cp1250").decode("cp1252") + " 2019",
        "9:40:32",
        "dmy",
        "2019-10-19T09:40:32",
    ),
    "Russian, Cyrillic code page": ("19 " + "окт".encode("cp1251").decode("cp1252") + " 2019", "9:40:32", "dmy", "2019-10-19T09:40:32"),
    "Polish genitive": ("19 sierpnia 2019", "9:40:32", "dmy", "2019-08-19T09:40:32"),
    "Chinese": ("2022年3月14日", "下午 3:11:12", "ymd", "2022-03-14T15:11:12"),
    "Korean": ("2022. 3. 14.", "오후 3:11:12", "ymd", "2022-03-14T15:11:12"),
    "American": ("Mar 14, 2022", "03:11:12 PM", "dmy", "2022-03-14T15:11:12"),
    "year of two digits": ("14-MAR-22", "11:52:46", "dmy", "2022-03-14T11:52:46"),
    "date and time in one text": ("14.03.2022, 11:52:46", "", "mdy", "2022-03-14T11:52:46"),
    "ISO in one text": ("2022-03-14T11:52:46", "", "mdy", "2022-03-14T11:52:46"),
    "Japanese code page": (
        "2022年3月14日".encode("cp932").decode("cp1252"),
        "03:11:12 午後".encode("cp932").decode("cp1252"),
        "ymd",
        "2022-03-14T15:11:12",
    ),
    "Chinese code page": ("2022年3月14日".encode("gb18030").decode("cp1252"), "11:52:46", "ymd", "2022-03-14T11:52:46"),
    "American text of a JEOL": ("3/14/2023", "11:52:46", "ymd", "2023-03-14T11:52:46"),
    "fraction behind a comma": ("5 juin 2022", "10:11:12,5", "dmy", "2022-06-05T10:11:12.500000"),
}
UNREAD = {
    "no such month": ("14/13/2022", "11:52:46", "mdy"),
    "no such day": ("31/02/2022", "11:52:46", "dmy"),
    "two months with this beginning": ("5 jui 2022", "11:52:46", "dmy"),
    "text month": ("19 Xyz 2019", "9:40:32", "dmy"),
    "two digits in three places": ("03.04.05", "11:52:46", "dmy"),
    "no seconds": ("14/03/2022", "11:52", "mdy"),
    "no separators": ("20220314", "115246", "ymd"),
    "only a time": ("", "11:52:46", "mdy"),
}


@pytest.mark.parametrize("name", READ)
def test_a_date_with_one_meaning_is_read(name: str) -> None:
    date, clock, order, expected = READ[name]
    found = acquired(date, clock, order, SAVED_NS + 365 * 86_400 * 10**9 if name == "usual order, file copied a year later" else SAVED_NS)
    assert found.moment is not None, found
    assert (found.moment.text, found.notes) == (expected, ())


@pytest.mark.parametrize("name", UNREAD)
def test_a_date_without_a_meaning_is_shown_as_written(name: str) -> None:
    date, clock, order = UNREAD[name]
    found = acquired(date, clock, order, SAVED_NS)
    assert found.moment is None
    assert found.unread == f"{date} {clock}".strip()


@pytest.mark.parametrize(("date", "order"), [("03/12/2022", "mdy"), ("3/12/2022", ""), ("12/3/2022", "ymd"), ("12 lis 2022", "dmy")])
def test_the_modification_time_decides_between_two_meanings(date: str, order: str) -> None:
    for day in (datetime(2022, 12, 3, 12, tzinfo=UTC), datetime(2022, 3, 12, 12, tzinfo=UTC)) if "lis" not in date else (
        datetime(2022, 10, 12, 12, tzinfo=UTC), datetime(2022, 11, 12, 12, tzinfo=UTC)
    ):  # fmt: skip
        found = acquired(date, "11:52:46", order, int(day.timestamp()) * 10**9)
        assert found.moment is not None
        assert found.moment.text[:10] == day.isoformat()[:10]
        assert all("by the file's modification time" in note for note in found.notes)


def test_no_date_is_no_problem_of_the_date() -> None:
    assert acquired("", " ", "dmy", 0).unread == ""


def test_names_of_months_are_those_of_cldr() -> None:
    for language in LANGUAGES:
        months = Locale(language).months
        for context in ("format", "stand-alone"):
            for width in ("abbreviated", "wide"):
                for month, name in months[context][width].items():
                    assert month in months_named(name), (language, name)
    assert all(name == folded(name) for names in MONTH_NAMES for name in names)


def fei(date: str, clock: str = "11:52:46") -> ExportedFile:
    image = np.random.default_rng(0).integers(20, 230, (88, 102), dtype=np.uint8)
    text = (
        f"[User]\nDate={date}\nTime={clock}\n[Beam]\nBeam=EBeam\n[EScan]\nDwell=3e-06\nPixelWidth=1e-08\n"
        "FrameTime=0.29\nLineTime=0.003272\n[Image]\nResolutionX=102\nResolutionY=88\n"
    )
    stream = io.BytesIO()
    tifffile.imwrite(stream, image, extratags=[(34682, "s", 0, text, True)], metadata=None)
    return ExportedFile(0, "a.tif", stream.getvalue(), "", SAVED_NS, SAVED_NS)


@pytest.mark.parametrize("date", ["14/03/2022", "2022-03-14", "03/14/2022"])
def test_an_unambiguous_date_of_fei_is_read(date: str) -> None:
    inspection = inspect_file(fei(date), ScanProfile())
    assert inspection.acquired.value == "2022-03-14T11:52:46"
    assert inspection.problems == ()
    assert read_info(fei(date), ScanProfile()).embedded_time_ns is not None


@pytest.mark.parametrize("date", ["14/13/2022", "14 Foo 2022", ""])
def test_inspect_predicts_that_a_run_refuses_the_date(date: str) -> None:
    with pytest.raises(BadImage) as refused:
        read_info(fei(date), ScanProfile())
    [problem] = inspect_file(fei(date), ScanProfile()).problems
    assert str(refused.value) == f"a.tif: {problem}"
    assert date in problem
    if date:
        assert "were not understood" in problem


@pytest.mark.parametrize("clock", ["2:05 PM", "14:05"])
def test_a_time_without_seconds_is_refused_for_that_reason(clock: str) -> None:
    with pytest.raises(BadImage, match=f"'3/14/2022 {clock}' lack the seconds"):
        read_info(fei("3/14/2022", clock), ScanProfile())


def test_names_of_date_and_time_of_a_zeiss_may_be_german() -> None:
    lines = ["0", "AP_DATE", "Datum :14 Mrz 2022", "AP_TIME", "Zeit :11:52:46", ""]
    moment = zeiss.header(zeiss.parse("\r\n".join(lines)), 1024, 768).embedded
    assert moment is not None
    assert moment.text == "2022-03-14T11:52:46"


def test_a_date_that_the_modification_time_replaces_is_noted() -> None:
    image = np.random.default_rng(0).integers(20, 230, (88, 102), dtype=np.uint8)
    stream = io.BytesIO()
    tifffile.imwrite(stream, image)
    text = b"$CM_FORMAT JEOL/EO\r\n$CM_DATE 14 of March\r\n$CM_TIME 11:52:46\r\n$CM_FULL_SIZE 102 88\r\n"
    assert jeol.read_sidecar(text) is not None
    file = ExportedFile(0, "a.tif", stream.getvalue(), "", SAVED_NS, SAVED_NS, text)
    profile = ScanProfile(dwell_time_s=1e-6, row_time_s=1e-3, pixel_size_m=1e-8)
    assert read_info(file, profile).notes == inspect_file(file, profile).notes
    assert "'14 of March 11:52:46' were not understood; the modification time" in read_info(file, profile).notes[0]
