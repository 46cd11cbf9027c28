"""Whether the libraries for PDF are installed, without importing them."""

from __future__ import annotations

from importlib import util

from semlive.errors import BadInput

_PACKAGES = ("fpdf", "pypdf")


def require_pdf_libraries(option: str) -> None:
    """Check that the libraries for PDF are installed.

    Args:
        option: option that needs them, for the message.

    Raises:
        BadInput: they are not installed.
    """
    if any(util.find_spec(name) is None for name in _PACKAGES):
        raise BadInput(f"{option}: fpdf2 and pypdf are not installed; pip install semlive[pdf].")
