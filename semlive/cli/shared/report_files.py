"""Further files of a report, PDF and figures; the same for `report` and `diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from semlive.cli.shared.output_path import write_bytes
from semlive.cli.shared.progress_bar import progress_bar
from semlive.report.document.blocks import Document
from semlive.report.document.figure_files import write_figures
from semlive.report.document.pdf_writer import pdf_bytes


def write_report_files(document: Document, pdf: Path | None, figures: Path | None) -> dict[str, Any]:
    """Write PDF and figures if they are requested.

    Returns:
        ``figures``, the written files, and ``pdf``, the file or None, as JSON.
    """
    written: list[Path] = []
    if pdf is not None:
        with progress_bar("writing the PDF", "figure") as progress:
            write_bytes(pdf, pdf_bytes(document, progress))
    if figures is not None:
        with progress_bar("writing", "figure") as progress:
            written = write_figures(figures, document, progress)
    return {"figures": [str(path) for path in written], "pdf": None if pdf is None else str(pdf)}
