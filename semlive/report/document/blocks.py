"""Parts of a document: paragraphs, lists, tables and figures in sections. All text is plain; the writers escape it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from matplotlib.figure import Figure

from semlive.report.style import figure_bytes, publication_style


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Running text."""

    text: str


@dataclass(frozen=True, slots=True)
class Bullets:
    """A bulleted list."""

    items: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class KeyFigures:
    """The main results, as pairs of label and value."""

    entries: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        caption: title, one sentence.
        headings: title of each column.
        rows: text of the cells.
        text: the cells are text and not numbers.
        folded: the page shows the caption only, until it is opened.
    """

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: bool = False
    folded: bool = False


@dataclass(frozen=True, slots=True)
class Listing:
    """Text with its line breaks, folded on the page.

    Attributes:
        caption: title.
        text: the lines.
    """

    caption: str
    text: str


@dataclass(frozen=True, eq=False)
class FigureBlock:
    """A figure with a caption that is complete without the text.

    Attributes:
        key: name of its files.
        title: what it shows, a phrase without a full stop; also its text for readers who cannot see it.
        caption: how to read it.
        figure: the figure.
    """

    key: str
    title: str
    caption: str
    figure: Figure

    @cached_property
    def svg(self) -> bytes:
        """The figure as SVG, drawn once for the page and for the file."""
        with publication_style():
            return figure_bytes(self.figure, "svg")


Block = Paragraph | Bullets | KeyFigures | Table | Listing | FigureBlock


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A part with a heading.

    Attributes:
        title: heading.
        blocks: content.
    """

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """A report.

    Attributes:
        title: name of the log.
        subtitle: what was measured on what, and when.
        sections: parts, in order.
    """

    title: str
    subtitle: str
    sections: tuple[Section, ...]

    def figures(self) -> Iterator[tuple[int, FigureBlock]]:
        """Yield each figure with its number from 1."""
        blocks = (block for section in self.sections for block in section.blocks if isinstance(block, FigureBlock))
        return enumerate(blocks, start=1)


def figure_caption(number: int, block: FigureBlock) -> str:
    """The caption with number and title."""
    return f"Figure {number}. {block.title}. {block.caption}"
