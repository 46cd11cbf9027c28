"""Sidecars: text files that microscopes write for their images."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

IMAGE_SUFFIXES = (".tif", ".tiff", ".png")
SIDECAR_SUFFIXES = (".txt", ".hdr")


def sidecar_names(image: str) -> tuple[str, ...]:
    """Return the possible names of the text file of an image: ``a.txt`` (JEOL, Hitachi), ``a-tif.hdr`` and ``a.hdr`` (TESCAN)."""
    stem, _, suffix = image.rpartition(".")
    if not stem:
        return ()
    return (f"{stem}.txt", f"{stem}.TXT", f"{stem}-{suffix}.hdr", f"{stem}.hdr")


def sidecar_of(image: Path, exists: Callable[[Path], bool] = Path.is_file) -> Path | None:
    """Return the text file of an image, or None."""
    return next((path for name in sidecar_names(image.name) if exists(path := image.with_name(name))), None)
