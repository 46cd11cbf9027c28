"""`semlive import`: another engine's disparity maps become a log."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.progress_bar import progress_bar
from semlive.cli.terminal import echo
from semlive.data.settings import SpecimenSettings
from semlive.errors import BadInput
from semlive.service.replay.import_maps import ImportRequest, as_json, import_folder


class Engine(StrEnum):
    """Engines whose text exports are read."""

    SEMLIVE = "semlive"
    SEMLIVE_DIC = "semlive-dic"
    VIC2D = "vic2d"
    DICE = "dice"
    OPENCORR = "opencorr"
    PYVALE = "pyvale"


class Axis(StrEnum):
    """Image axes."""

    X = "x"
    Y = "y"


def import_maps(
    folder: Annotated[Path, typer.Argument(help="With frames.csv and disparity_<ref>_<cur>.csv; docs/how-to/import.md shows both.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The log to write, LOG.mcap.")],
    specimen_area_mm2: Annotated[float | None, typer.Option(help="Cross-section in mm2; without it no elastic constants.")] = None,
    loading_axis: Annotated[Axis, typer.Option(help="Image axis that is pulled.")] = Axis.Y,
    engine: Annotated[Engine | None, typer.Option("--from", help="Who wrote the maps; by default told from each header.")] = None,
    subset_px: Annotated[int | None, typer.Option(help="Edge of the engine's subset in px; by default what the maps tell, else 0.")] = None,
    json_asked: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Make a log of disparity maps that another engine made: VIC-2D, DICe, OpenCorr, pyvale, or plain CSV."""
    if subset_px is not None and not 0 <= subset_px < 10_000:
        raise BadInput(f"--subset-px {subset_px}: is no subset; give its edge in px, or leave the option out.")
    try:
        specimen = SpecimenSettings(area_mm2=specimen_area_mm2, loading_axis=loading_axis.value)
    except ValueError as error:
        raise BadInput(f"--specimen-area-mm2 {specimen_area_mm2}: {error}; give the cross-section in mm2.") from error
    asked = ImportRequest(folder, out, specimen, engine.value if engine else None, subset_px)
    with progress_bar("importing", "pair") as progress:
        done = import_folder(asked, progress)
    for name in done.skipped:
        echo(f"{name}: left out, it starts from neither frame 0 nor its own pair, or its frames are not in frames.csv", err=True)
    if json_asked:
        typer.echo(json.dumps(as_json(asked, done)))
        return
    grid = done.grid
    echo(
        f"{out}: {done.pairs} pairs, {done.maps} maps of {grid.nx} x {grid.ny} "
        f"points {grid.step_px} px apart, from {', '.join(done.engines)}"
    )
