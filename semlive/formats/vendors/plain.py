"""Files without scan metadata: PNG, and TIFF without the header of a vendor. All values come from the profile."""

from __future__ import annotations

from semlive.formats.metadata.header import Header


def header(*notes: str) -> Header:
    """Return a header without values."""
    return Header(vendor="plain", notes=notes)
