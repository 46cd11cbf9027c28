"""`semlive inspect`: what exported files say, where each value comes from, and what is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.inspect_table import print_inspection
from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images.inspection import Inspection, as_json, inspect_file, inspect_sidecar
from semlive.formats.vendors.png import is_png
from semlive.formats.vendors.tiff import is_tiff
from semlive.inputs.files import MAX_IMAGE_BYTES, read_regular
from semlive.service.config.configuration import load_config
from semlive.service.watch.sidecars import IMAGE_SUFFIXES, SIDECAR_SUFFIXES, sidecar_of


def inspect(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Images as the SEM exported them; text files beside them are found.")
    ],
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    config: Annotated[
        Path | None, typer.Option("--config", help="A run's configuration, whose scan profiles fill what files lack.")
    ] = None,
) -> None:
    """Show what exported images say of their scan, where each value comes from, and what is missing."""
    profile = ScanProfile() if config is None else load_config(config).sem.whole_profile
    seen = [(path, _inspected(path, profile)) for path in files]
    if as_json_object:
        typer.echo(json.dumps({"files": [as_json(one, str(path)) for path, one in seen]}))
        return
    console = Console()
    for path, one in seen:
        print_inspection(console, path, one)


def _inspected(path: Path, profile: ScanProfile) -> Inspection:
    """One file, looked at.

    Raises:
        BadImage: it cannot be read, or is neither an image nor a text that a microscope writes beside one.
    """
    try:
        data, mtime_ns = read_regular(path, MAX_IMAGE_BYTES), path.stat().st_mtime_ns
    except OSError as error:
        raise BadImage(f"{path}: cannot be read ({error.strerror}); give an exported image file") from error
    if path.suffix.lower() in SIDECAR_SUFFIXES and not (is_tiff(data) or is_png(data)):
        return _beside(path, data, mtime_ns, profile)
    if not (is_tiff(data) or is_png(data)):
        raise BadImage(f"{path}: is neither TIFF nor PNG; give an exported image file")
    beside = sidecar_of(path)
    sidecar = None if beside is None else read_regular(beside, MAX_IMAGE_BYTES)
    return inspect_file(ExportedFile(0, path.name, data, "", mtime_ns, mtime_ns, sidecar), profile)


def _beside(path: Path, sidecar: bytes, mtime_ns: int, profile: ScanProfile) -> Inspection:
    """A text file that was named itself: its image is looked at, if it is there."""
    images = [other for other in path.parent.iterdir() if other.suffix.lower() in IMAGE_SUFFIXES and sidecar_of(other) == path]
    if images:
        return _inspected(min(images), profile)
    alone = inspect_sidecar(path.name, sidecar, mtime_ns, profile)
    if alone is None:
        raise BadImage(f"{path}: is neither TIFF nor PNG, nor a text that a microscope writes beside one; give an exported image file")
    return alone
