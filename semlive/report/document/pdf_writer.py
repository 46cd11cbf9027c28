"""A document as PDF: text and tables by fpdf2, figures as the vector graphics of matplotlib, laid over their places by pypdf."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib

from semlive.report.document.blocks import Block, Bullets, Document, FigureBlock, KeyFigures, Listing, Paragraph, Table, figure_caption
from semlive.report.document.pdf_libraries import require_pdf_libraries
from semlive.report.style import figure_bytes, publication_style

if TYPE_CHECKING:
    from fpdf import FPDF

MAX_ROWS = 60
"""Largest number of rows of a table in the PDF; the page and `semlive export` have all."""
MAX_LISTING_LINES = 200
_MARGIN_MM, _MM_PER_INCH, _POINTS_PER_MM = 20.0, 25.4, 72.0 / 25.4
_FONT = "DejaVu"


@dataclass(frozen=True, slots=True)
class _Place:
    """Place of a figure: index of the page, and its box in mm from the upper left corner."""

    page: int
    left_mm: float
    top_mm: float
    width_mm: float
    height_mm: float
    content: bytes


def pdf_bytes(document: Document, progress: Callable[[int, int], object] = lambda *_: None) -> bytes:
    """Write a document as an A4 PDF with an outline.

    Args:
        document: the report.
        progress: called with the number of placed figures and of all figures.

    Raises:
        BadInput: the libraries for PDF are not installed.
    """
    require_pdf_libraries("--pdf")
    return _merged(*_Writer(document, progress).write())


class _Writer:
    """Writes text and tables from top to bottom, with empty space for the figures."""

    def __init__(self, document: Document, progress: Callable[[int, int], object]) -> None:
        self._document, self._progress = document, progress
        self._pdf, self._places = _empty(document.title), list[_Place]()
        self._numbers = {block.key: number for number, block in document.figures()}

    def write(self) -> tuple[bytes, list[_Place]]:
        """Return the PDF without figures, and the figures with their places."""
        pdf = self._pdf
        pdf.add_page()
        self._text(self._document.title, size=16, bold=True)
        self._text(self._document.subtitle, size=9, grey=90)
        with publication_style():
            for section in self._document.sections:
                self._heading(section.title)
                for block in section.blocks:
                    self._block(block)
        return bytes(pdf.output()), self._places

    def _block(self, block: Block) -> None:
        match block:
            case Paragraph(text):
                self._text(text)
            case Bullets(items):
                for item in items:
                    self._text(f"•  {item}", indent=4.0)
            case KeyFigures(entries):
                for label, value in entries:
                    self._text(f"{label}: {value}", size=10, bold=True)
            case Listing(caption, text):
                lines = text.splitlines()
                omitted = f"\n({len(lines) - MAX_LISTING_LINES} more lines are on the page)" if len(lines) > MAX_LISTING_LINES else ""
                self._text(caption, size=8, bold=True)
                self._text("\n".join(lines[:MAX_LISTING_LINES]) + omitted, size=6.5)
            case Table():
                self._table(block)
            case FigureBlock():
                self._figure(block)

    def _heading(self, title: str) -> None:
        if self._pdf.will_page_break(40):
            self._pdf.add_page()
        self._pdf.ln(3)
        self._pdf.start_section(title)
        self._text(title, size=12, bold=True)

    def _text(self, text: str, *, size: float = 9, bold: bool = False, grey: int = 0, indent: float = 0.0) -> None:
        pdf = self._pdf
        pdf.set_font(_FONT, "B" if bold else "", size)
        pdf.set_text_color(grey)
        pdf.set_x(_MARGIN_MM + indent)
        pdf.multi_cell(pdf.epw - indent, 0.5 * size, text, align="L", new_x="LMARGIN", new_y="NEXT")
        pdf.set_text_color(0)
        pdf.ln(1.5)

    def _table(self, table: Table) -> None:
        rows = table.rows[:MAX_ROWS]
        omitted = f" The first {MAX_ROWS} of {len(table.rows)} rows; the page has all." if len(table.rows) > MAX_ROWS else ""
        if self._pdf.will_page_break(25):
            self._pdf.add_page()
        self._text(table.caption + omitted, size=8, grey=60)
        self._pdf.set_font(_FONT, "", 7)
        weights = _column_weights(table)
        align = ["LEFT" if table.text or at == 0 else "RIGHT" for at in range(len(table.headings))]
        with self._pdf.table(
            col_widths=weights,
            text_align=align,
            line_height=3.6,
            borders_layout="HORIZONTAL_LINES",
            padding=0.6,
            first_row_as_headings=True,
        ) as drawn:
            for cells in (table.headings, *rows):
                row = drawn.row()
                for cell in cells:
                    row.cell(cell)
        self._pdf.ln(3)

    def _figure(self, block: FigureBlock) -> None:
        pdf = self._pdf
        width_inch, height_inch = block.figure.get_size_inches()
        width = min(_MM_PER_INCH * width_inch, pdf.epw)
        height = width * height_inch / width_inch
        if pdf.will_page_break(height + 20):
            pdf.add_page()
        left = _MARGIN_MM + 0.5 * (pdf.epw - width)
        self._places.append(_Place(pdf.page - 1, left, pdf.get_y(), width, height, figure_bytes(block.figure, "pdf")))
        pdf.set_y(pdf.get_y() + height + 1)
        number = self._numbers[block.key]
        self._text(figure_caption(number, block), size=8, grey=60)
        pdf.ln(2)
        self._progress(number, len(self._numbers))


def _column_weights(table: Table) -> list[int]:
    """Relative width of each column: the length of its longest cell, within bounds."""
    columns = zip(table.headings, *table.rows[:MAX_ROWS], strict=True)
    return [min(max(max(len(cell) for cell in column), 6), 60) for column in columns]


def _empty(title: str) -> FPDF:
    # Only this command needs the library, and it is an optional part of the installation.
    from fpdf import FPDF  # noqa: PLC0415

    class Pages(FPDF):
        """Pages with their number at the foot."""

        def footer(self) -> None:
            self.set_y(-14)
            self.set_font(_FONT, "", 7)
            self.set_text_color(110)
            self.cell(0, 6, f"{title} - semlive - {self.page_no()} / {{nb}}", align="C")
            self.set_text_color(0)

    pdf = Pages(format="A4")
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    pdf.add_font(_FONT, "", fonts / "DejaVuSans.ttf")
    pdf.add_font(_FONT, "B", fonts / "DejaVuSans-Bold.ttf")
    pdf.set_margin(_MARGIN_MM)
    pdf.set_auto_page_break(True, 18)
    pdf.set_title(title)
    pdf.set_lang("en")
    return pdf


def _merged(text: bytes, places: list[_Place]) -> bytes:
    """Lay the figures over the pages."""
    from pypdf import PdfReader, PdfWriter, Transformation  # noqa: PLC0415

    writer = PdfWriter(clone_from=PdfReader(io.BytesIO(text)))
    for place in places:
        page = writer.pages[place.page]
        figure = PdfReader(io.BytesIO(place.content)).pages[0]
        scale = place.width_mm * _POINTS_PER_MM / float(figure.mediabox.width)
        left = place.left_mm * _POINTS_PER_MM
        bottom = float(page.mediabox.height) - (place.top_mm + place.height_mm) * _POINTS_PER_MM
        page.merge_transformed_page(figure, Transformation().scale(scale).translate(left, bottom))
    stream = io.BytesIO()
    writer.write(stream)
    return stream.getvalue()
