"""`semlive import`: write a log from the disparity maps of another DIC program."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.shared.output_path import regular_output_file
from semlive.cli.shared.progress_bar import progress_bar
from semlive.cli.shared.terminal import echo
from semlive.data.settings import SpecimenSettings
from semlive.errors import BadInput
from semlive.service.replay.import_maps import ImportRequest, as_json, import_folder
from semlive.service.replay.import_noise import noise_text

MAX_HOLD_S = 1e6  # twelve days; a longer time has another unit


class Engine(StrEnum):
    """DIC programs whose text exports can be read."""

    SEMLIVE = "semlive"
    SEMLIVE_DIC = "semlive-dic"
    VIC2D = "vic2d"
    DICE = "dice"
    OPENCORR = "opencorr"
    PYVALE = "pyvale"
    OTHER = "other"


class ImageAxis(StrEnum):
    """Image axes."""

    X = "x"
    Y = "y"


def import_maps(
    folder: Annotated[
        Path, typer.Argument(help="Folder with frames.csv and disparity_<ref>_<cur>.csv; docs/how-to/import.md describes both.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Log to write, LOG.mcap.")],
    specimen_area_mm2: Annotated[
        float | None, typer.Option(help="Cross-section in mm2; without it there are no elastic constants.")
    ] = None,
    loading_axis: Annotated[ImageAxis, typer.Option(help="Image axis of the load.")] = ImageAxis.Y,
    engine: Annotated[
        Engine | None, typer.Option("--from", help="Program that wrote the maps; by default determined from each header.")
    ] = None,
    subset_px: Annotated[
        int | None, typer.Option(help="Edge of the subset in px; by default that in the maps, else estimated from their noise.")
    ] = None,
    hold_s: Annotated[
        float | None,
        typer.Option(help="Time from the end of each step to the start of its pair in s; diagnosis assumes 30 without it."),
    ] = None,
    as_json_object: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a log from disparity maps of another DIC program: VIC-2D, DICe, OpenCorr, pyvale, or plain CSV."""
    if subset_px is not None and not 0 <= subset_px < 10_000:
        raise BadInput(f"--subset-px {subset_px}: must be from 0 to 9999; give the edge of the subset in px, or leave the option out.")
    if hold_s is not None and not 0.0 <= hold_s < MAX_HOLD_S:
        raise BadInput(f"--hold-s {hold_s:g}: must be from 0 to {MAX_HOLD_S:g}; give the time from the end of a step to its pair in s.")
    try:
        specimen = SpecimenSettings(area_mm2=specimen_area_mm2, loading_axis=loading_axis.value)
    except ValueError as error:
        raise BadInput(f"--specimen-area-mm2 {specimen_area_mm2}: {error}; give the cross-section in mm2.") from error
    regular_output_file(out, "--out")
    request = ImportRequest(folder, out, specimen, engine.value if engine else None, subset_px, hold_s)
    with progress_bar("importing", "pair") as progress:
        imported = import_folder(request, progress)
    for name in imported.skipped:
        echo(
            f"{name}: not imported; it refers neither to frame 0 nor to its own pair, or frames.csv does not list its frames",
            err=True,
        )
    if as_json_object:
        typer.echo(json.dumps(as_json(request, imported)))
        return
    grid = imported.grid
    echo(
        f"{out}: {imported.pairs} pairs, {imported.maps} maps of {grid.nx} x {grid.ny} "
        f"points {grid.step_px} px apart, from {', '.join(imported.engines)}"
    )
    echo(noise_text(imported.noise, grid.step_px))
    if hold_s is None:
        echo(
            "time from the end of each step to the start of its pair: unknown; diagnosis assumes 30 s, and the amplitudes of creep and of "
            "transients after steps depend on it; give it with --hold-s"
        )
