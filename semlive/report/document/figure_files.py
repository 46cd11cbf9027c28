"""Figures of a document as files for a paper: each as PNG, SVG and PDF, and all captions in one text and one JSON file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from semlive.errors import BadInput
from semlive.report.document.blocks import Document, figure_caption
from semlive.report.style import figure_bytes, publication_style

KINDS = ("png", "svg", "pdf")


def write_figures(folder: Path, document: Document, progress: Callable[[int, int], object] = lambda *_: None) -> list[Path]:
    """Write every figure as PNG (300 dpi), SVG and PDF in the width of a journal page, then `captions.txt` and `captions.json`.

    Args:
        folder: is made if it does not exist.
        document: the report.
        progress: called with the number of written figures and of all figures.

    Returns:
        All written files.

    Raises:
        BadInput: the folder cannot be written.
    """
    figures = list(document.figures())
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with publication_style():
            for number, block in figures:
                for kind in KINDS:
                    path = folder / f"{block.key}.{kind}"
                    path.write_bytes(block.svg if kind == "svg" else figure_bytes(block.figure, kind))
                    written.append(path)
                progress(number, len(figures))
        captions = {
            block.key: {"number": number, "title": block.title, "caption": figure_caption(number, block)} for number, block in figures
        }
        text = "\n\n".join(f"{key}: {entry['caption']}" for key, entry in captions.items())
        for name, content in (("captions.txt", text + "\n"), ("captions.json", json.dumps(captions, indent=1, ensure_ascii=False) + "\n")):
            (folder / name).write_text(content, encoding="utf-8")
            written.append(folder / name)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written ({error.strerror or error}); give a writable folder") from error
    return written
