"""Files that say nothing of their scan: PNG, and TIFF without a vendor's header. Everything comes from the profile."""

from __future__ import annotations

from semlive.formats.metadata.header import Header


def header() -> Header:
    """Nothing."""
    return Header(vendor="plain")
