"""Options for further files of a report, PDF and figures; the same for `report`, `diagnose` and `qualify`."""

from __future__ import annotations

from pathlib import Path

from semlive.cli.shared.output_path import output_file, output_folder
from semlive.report.document.pdf_libraries import require_pdf_libraries


def pdf_option(path: Path | None) -> Path | None:
    """Check the file of `--pdf`, and that the libraries for it are installed, before the work begins.

    Raises:
        BadInput: the file cannot be written, or the libraries are not installed.
    """
    if path is not None:
        require_pdf_libraries("--pdf")
        output_file(path, "--pdf")
    return path


def figures_option(folder: Path | None) -> Path | None:
    """Check the folder of `--figures` before the work begins.

    Raises:
        BadInput: no file can be made in it.
    """
    return None if folder is None else output_folder(folder, "--figures")
