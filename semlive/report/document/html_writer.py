"""A document as one HTML page that needs nothing else: figures are part of it as SVG, and an image saved from it is a file for a paper."""

from __future__ import annotations

import html
import urllib.parse
from collections.abc import Callable, Sequence

from semlive.report.document.blocks import Block, Bullets, Document, FigureBlock, KeyFigures, Listing, Paragraph, Section, Table
from semlive.report.style import publication_style

_UNESCAPED = " !$'*+,-./:;=?@_~[]{}|^`"
"""Characters of an SVG that a quoted address may contain: base64 of the complete text would be larger by a third."""
_STYLE = """
:root { color-scheme: light dark;
  --ink: #0f172a; --paper: #ffffff; --soft: #475569; --line: #cbd5e1; --accent: #1d4ed8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e2e8f0; --paper: #0f172a; --soft: #a8b5c8; --line: #334155; --accent: #7fb2ff; } }
body { font: 15px/1.55 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 54rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: 0; } h2 { font-size: 1.2rem; margin-top: 2.4rem; border-bottom: 1px solid var(--line); }
.soft { color: var(--soft); margin-top: .2rem; } a { color: var(--accent); }
.key { display: flex; flex-wrap: wrap; gap: 1rem; margin: 1.2rem 0; }
.key div { border: 1px solid var(--line); border-radius: .6rem; padding: .6rem 1rem; }
.key dt { font-size: .9rem; } .key dd { margin: 0; font-size: 1.2rem; font-weight: 600; color: var(--accent); }
figure { margin: 1.6rem 0; break-inside: avoid; } figure img { display: block; max-width: 100%; margin: auto; border-radius: .4rem; }
figcaption, caption { font-size: .9rem; color: var(--soft); text-align: left; padding: .4rem 0; } figcaption b { color: var(--ink); }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; font-size: .9rem; }
th, td { text-align: right; padding: .2rem .6rem; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
.scroll { overflow-x: auto; margin: 1rem 0; } .text th, .text td { text-align: left; vertical-align: top; overflow-wrap: anywhere; }
pre { overflow-x: auto; font-size: .85rem; } details { margin: .6rem 0; } summary { cursor: pointer; }
nav ul { columns: 2; padding: 0; list-style: none; } @media print { nav { display: none; } body { max-width: none; margin: 0; } }
"""


def html_page(document: Document, progress: Callable[[int, int], object] = lambda *_: None) -> str:
    """Write a document as HTML.

    Args:
        document: the report.
        progress: called with the number of drawn figures and of all figures.
    """
    count = sum(1 for _ in document.figures())
    numbers = {block.key: number for number, block in document.figures()}
    body: list[str] = []
    with publication_style():
        for at, section in enumerate(document.sections, start=1):
            body.append(f'<section id="s{at}" aria-labelledby="h{at}">\n<h2 id="h{at}">{html.escape(section.title)}</h2>')
            for block in section.blocks:
                number = numbers.get(block.key, 0) if isinstance(block, FigureBlock) else 0
                body.append(_block(block, number))
                if number:
                    progress(number, count)
            body.append("</section>")
    title = html.escape(document.title)
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title} - semlive</title><style>{_STYLE}</style>'
    )
    top = f'<header><h1>{title}</h1><p class="soft">{html.escape(document.subtitle)}</p></header>'
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{top}\n{_contents(document.sections)}\n<main>\n'
        + "\n".join(body)
        + "\n</main>\n</body></html>\n"
    )


def _contents(sections: Sequence[Section]) -> str:
    entries = "".join(f'<li><a href="#s{at}">{html.escape(section.title)}</a></li>' for at, section in enumerate(sections, start=1))
    return f'<nav aria-label="contents"><ul>{entries}</ul></nav>'


def _block(block: Block, number: int) -> str:
    match block:
        case Paragraph(text):
            return f"<p>{html.escape(text)}</p>"
        case Bullets(items):
            return "<ul>" + "".join(f"<li>{html.escape(item)}</li>" for item in items) + "</ul>"
        case KeyFigures(entries):
            boxes = (f"<div><dt>{html.escape(label)}</dt><dd>{html.escape(value)}</dd></div>" for label, value in entries)
            return f'<dl class="key">{"".join(boxes)}</dl>'
        case Listing(caption, text):
            content = f'<pre tabindex="0" role="region" aria-label="{html.escape(caption)}">{html.escape(text)}</pre>'
            return f"<details><summary>{html.escape(caption)}</summary>{content}</details>"
        case Table():
            return _table(block)
        case FigureBlock():
            return _figure(block, number)


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{html.escape(heading)}</th>' for heading in table.headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>\n" for row in table.rows)
    kind = ' class="text"' if table.text else ""
    caption = "" if table.folded else f"<caption>{html.escape(table.caption)}</caption>"
    label = html.escape(table.caption)
    drawn = f"<table{kind}>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    # A table that scrolls must be reached by the keyboard.
    content = f'<div class="scroll" tabindex="0" role="region" aria-label="{label}">{drawn}</div>'
    return f"<details><summary>{label}</summary>{content}</details>" if table.folded else content


def _figure(block: FigureBlock, number: int) -> str:
    svg = urllib.parse.quote(block.svg.decode("utf-8"), safe=_UNESCAPED)
    width = 96 * block.figure.get_size_inches()[0]
    title = html.escape(block.title)
    image = f'<img alt="{title}" width="{width:.0f}" src="data:image/svg+xml,{svg}">'
    caption = f"<b>Figure {number}. {title}.</b> {html.escape(block.caption)}"
    return f'<figure id="{html.escape(block.key)}">{image}<figcaption>{caption}</figcaption></figure>'
