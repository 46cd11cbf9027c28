"""The page of a report in Chromium: readable for people with a screen reader, in light and dark, and within the width of a phone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from playwright.sync_api import Page

from semlive.report.document.blocks import Bullets, Document, FigureBlock, KeyFigures, Listing, Paragraph, Section, Table
from semlive.report.document.html_writer import html_page


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    figure = Figure(figsize=(7.0, 2.0))
    figure.subplots().plot([0, 1])
    table = Table("All frames.", ("frame", "SHA-256"), (("0", "ab" * 32),), text=True)
    blocks = (
        KeyFigures((("E", "71.19 ± 0.26 GPa"),)),
        Paragraph("Text."),
        Bullets(("one",)),
        FigureBlock("curve", "Curve", "Read it.", figure),
    )
    more = (table, Table("Folded.", ("a", "b"), (("1", "2"),), folded=True), Listing("Configuration", "a: " + 300 * "x"))
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(html_page(Document("run", "specimen", (Section("Summary", blocks), Section("1 Results", more)))), encoding="utf-8")
    return path


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_report_is_readable(tab: Callable[..., Page], readable: Callable[[Page], None], page_file: Path, scheme: str) -> None:
    page = tab(color_scheme=scheme)
    page.goto(page_file.as_uri())
    for details in page.query_selector_all("details"):
        details.evaluate("element => element.open = true")
    readable(page)


def test_a_report_fits_a_phone_and_its_figures_are_images(tab: Callable[..., Page], page_file: Path) -> None:
    page = tab(viewport={"width": 390, "height": 844})
    page.goto(page_file.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 100)")
