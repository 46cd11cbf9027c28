"""Sidecars: text files that microscopes write for their images."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

IMAGE_SUFFIXES = (".tif", ".tiff", ".png")
SIDECAR_SUFFIXES = (".txt", ".hdr")


def sidecar_names(image: str) -> tuple[str, ...]:
    """Return the possible names of the text file of an image: ``a.txt`` (JEOL, Hitachi), ``a-tif.hdr`` and ``a.hdr`` (TESCAN)."""
    stem, _, suffix = image.rpartition(".")
    if not stem:
        return ()
    return (f"{stem}.txt", f"{stem}.TXT", f"{stem}-{suffix}.hdr", f"{stem}.hdr")


def sidecar_of(image: Path) -> Path | None:
    """Return the text file of an image, or None; letter case is ignored if no name agrees exactly."""
    exact = next((path for name in sidecar_names(image.name) if (path := image.with_name(name)).is_file()), None)
    if exact is not None:
        return exact
    try:
        other = in_other_case(image.name, text_files(image.parent))
    except OSError:
        return None
    return None if other is None else image.with_name(other)


def text_files(folder: Path) -> dict[str, str]:
    """Return the names of the text files in a folder by their names without letter case.

    Raises:
        OSError: the folder cannot be read.
    """
    with os.scandir(folder) as entries:
        return {entry.name.casefold(): entry.name for entry in entries if entry.name.lower().endswith(SIDECAR_SUFFIXES)}


def in_other_case(image: str, text_files: Mapping[str, str]) -> str | None:
    """Return the name of the text file of an image in any letter case, or None."""
    return next((text_files[name.casefold()] for name in sidecar_names(image) if name.casefold() in text_files), None)
