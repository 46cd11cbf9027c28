"""Writers of a document: one content as HTML, as PDF and as files of the figures."""

from __future__ import annotations

import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from pypdf import PdfReader

from semlive.errors import BadInput
from semlive.report.document import pdf_libraries
from semlive.report.document.blocks import Bullets, Document, FigureBlock, KeyFigures, Listing, Paragraph, Section, Table
from semlive.report.document.figure_files import write_figures
from semlive.report.document.html_writer import html_page
from semlive.report.document.pdf_writer import MAX_ROWS, pdf_bytes


def drawn() -> Figure:
    figure = Figure(figsize=(7.0, 1.0))
    figure.subplots().plot([0, 1])
    return figure


@pytest.fixture(scope="module")
def document() -> Document:
    table = Table("All frames.", ("frame", "strain 10⁻⁶"), tuple((str(at), f"{at} ± 1") for at in range(MAX_ROWS + 5)), folded=True)
    first = Section("Summary", (KeyFigures((("E", "71.19 ± 0.26 GPa"),)), Paragraph("a < b"), Bullets(("one", "two"))))
    second = Section(
        "1 Results", (FigureBlock("curve", "A <curve>", "Read it so.", drawn()), table, Listing("Configuration", "a: 1\nb: 2"))
    )
    return Document("run <7>", "specimen", (first, second, Section("2 More", (FigureBlock("second", "Another", "Also.", drawn()),))))


class Nesting(HTMLParser):
    """Records elements that are not closed in order, and identities."""

    VOID = frozenset(("meta", "img", "br"))

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.identities: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.identities += [value or "" for name, value in attrs if name == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def test_a_page_is_nested_needs_nothing_and_names_each_figure(document: Document) -> None:
    page = html_page(document)
    nesting = Nesting()
    nesting.feed(page)
    assert (nesting.open, nesting.wrong) == ([], [])
    assert len(nesting.identities) == len(set(nesting.identities))
    assert {target[1:] for target in re.findall(r'href="(#[^"]*)"', page)} <= set(nesting.identities)
    assert not re.search(r'src="(?!data:image/svg)|href="(?!#)|url\(|<script', page)
    assert "<b>Figure 1. A &lt;curve&gt;.</b> Read it so." in page
    assert "<b>Figure 2. Another.</b>" in page
    assert "<p>a &lt; b</p>" in page
    assert page.count("<tr>") == MAX_ROWS + 6


def test_a_page_is_the_same_when_it_is_written_again(document: Document) -> None:
    assert html_page(document) == html_page(document)


def test_a_pdf_has_text_outline_and_figures_and_bounded_tables(document: Document) -> None:
    reader = PdfReader(io.BytesIO(pdf_bytes(document)))
    text = "\n".join(page.extract_text() for page in reader.pages)
    assert "71.19 ± 0.26 GPa" in text
    assert "Figure 1. A <curve>. Read it so." in text
    assert f"The first {MAX_ROWS} of {MAX_ROWS + 5} rows; the page has all." in text
    assert [entry.title for entry in reader.outline if not isinstance(entry, list)] == ["Summary", "1 Results", "2 More"]
    fonts = str([page["/Resources"] for page in reader.pages])
    assert "/XObject" in fonts or "/Font" in fonts


def test_missing_libraries_for_pdf_are_named_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pdf_libraries, "_PACKAGES", ("fpdf", "no_such_package"))
    with pytest.raises(BadInput, match=r"--pdf: fpdf2 and pypdf are not installed; pip install semlive\[pdf\]"):
        pdf_libraries.require_pdf_libraries("--pdf")


def test_figures_are_files_with_captions_that_stand_alone(document: Document, tmp_path: Path) -> None:
    written = write_figures(tmp_path / "figures", document)
    names = [f"{key}.{kind}" for key in ("curve", "second") for kind in ("png", "svg", "pdf")] + ["captions.txt", "captions.json"]
    assert [path.name for path in written] == names
    assert int.from_bytes(written[0].read_bytes()[16:20], "big") == 2100  # 7 inches at 300 dpi
    assert b"<svg" in written[1].read_bytes()
    assert written[2].read_bytes().startswith(b"%PDF")
    captions = json.loads((tmp_path / "figures" / "captions.json").read_text(encoding="utf-8"))
    assert captions["second"] == {"number": 2, "title": "Another", "caption": "Figure 2. Another. Also."}
    assert "curve: Figure 1. A <curve>. Read it so." in (tmp_path / "figures" / "captions.txt").read_text(encoding="utf-8")


def test_a_folder_that_is_a_file_is_refused(document: Document, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(BadInput, match="cannot be written"):
        write_figures(tmp_path / "taken", document)
