"""Files of the report of a qualification, and of a comparison of several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from semlive.cli.shared.output_path import write_text
from semlive.cli.shared.report_files import write_report_files
from semlive.qualify.values import Qualification
from semlive.report.document.blocks import Document
from semlive.report.document.html_writer import html_page
from semlive.report.qualification_report import history_document, qualification_document


def write_report(found: Qualification, configuration: str, report: Path | None, pdf: Path | None) -> None:
    """Write the report of a qualification with the recommended configuration, as page, as PDF, or as both."""
    _write(qualification_document(found, configuration), report, pdf)


def write_history(found: Sequence[Qualification], report: Path | None, pdf: Path | None) -> None:
    """Write the comparison of several qualifications, as page, as PDF, or as both."""
    _write(history_document(found), report, pdf)


def _write(document: Document, report: Path | None, pdf: Path | None) -> None:
    if report is not None:
        write_text(report, html_page(document))
    write_report_files(document, pdf, None)
