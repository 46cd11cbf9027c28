"""`semlive inspect`: scan parameters of exported images, the source of each value, and what is missing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.before_run.inspect_table import print_inspection
from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.errors import BadImage
from semlive.formats.images.frames import other_format
from semlive.formats.images.inspection import Inspection, as_json, inspect_file, inspect_sidecar
from semlive.formats.vendors.png import is_png
from semlive.formats.vendors.tiff import is_tiff
from semlive.inputs.files import MAX_IMAGE_BYTES, read_regular
from semlive.service.config.configuration import load_config
from semlive.service.watch.sidecars import IMAGE_SUFFIXES, SIDECAR_SUFFIXES, sidecar_names, sidecar_of


def inspect(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Images as the SEM exported them; their text files in the same folder are read too."),
    ],
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    config: Annotated[
        Path | None, typer.Option("--config", help="Configuration of a run; its scan profiles supply values that the files lack.")
    ] = None,
    page: Annotated[int | None, typer.Option(min=1, help="Which image of TIFF files that contain several, from 1.")] = None,
) -> None:
    """Show the scan parameters of exported images, the source of each value, and what is missing."""
    loaded = None if config is None else load_config(config).sem
    profile, vendor = (ScanProfile(), None) if loaded is None else (loaded.scan_profile, loaded.vendor)
    if page is not None:
        profile = replace(profile, page=page)
    inspections = [(path, _inspected(path, profile, vendor)) for path in files]
    if as_json_object:
        typer.echo(json.dumps({"files": [as_json(inspection, str(path)) for path, inspection in inspections]}))
        return
    console = Console()
    for path, inspection in inspections:
        print_inspection(console, path, inspection)


def _inspected(path: Path, profile: ScanProfile, vendor: str | None) -> Inspection:
    """Scan parameters of one file.

    Raises:
        BadImage: the file cannot be read, or is neither an image nor the text file that a microscope writes with an image.
    """
    try:
        data, mtime_ns = read_regular(path, MAX_IMAGE_BYTES), path.stat().st_mtime_ns
    except OSError as error:
        raise BadImage(f"{path}: cannot be read ({error.strerror}); give an exported image file") from error
    if path.suffix.lower() in SIDECAR_SUFFIXES and not (is_tiff(data) or is_png(data)):
        return _inspected_sidecar(path, data, mtime_ns, profile, vendor)
    if not (is_tiff(data) or is_png(data)):
        raise BadImage(f"{path}: {other_format(data)}is neither TIFF nor PNG, and a run would not take it; set the SEM's export to TIFF")
    sidecar_path = sidecar_of(path)
    sidecar = None if sidecar_path is None else read_regular(sidecar_path, MAX_IMAGE_BYTES)
    return inspect_file(ExportedFile(0, path.name, data, "", mtime_ns, mtime_ns, sidecar), profile, vendor)


def _inspected_sidecar(path: Path, sidecar: bytes, mtime_ns: int, profile: ScanProfile, vendor: str | None) -> Inspection:
    """Scan parameters of a text file: those of its image, or of the text alone if the image does not exist."""
    name, others = path.name.casefold(), (image for image in path.parent.iterdir() if image.suffix.lower() in IMAGE_SUFFIXES)
    images = [image for image in others if name in map(str.casefold, sidecar_names(image.name)) and sidecar_of(image) == path]
    if images:
        return _inspected(min(images), profile, vendor)
    inspection = inspect_sidecar(path.name, sidecar, mtime_ns, profile)
    if inspection is None:
        raise BadImage(
            f"{path}: is neither TIFF nor PNG, nor the text file that a microscope writes with an image; give an exported image file"
        )
    return inspection
