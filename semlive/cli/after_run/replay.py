"""`semlive replay`: repeat the analysis of a log."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.cli.shared.tables import comparison_table, pair_status_line, result_table
from semlive.data.frame import FrameOrigin
from semlive.errors import BadInput
from semlive.service.analysis.result_json import json_differences, result_json
from semlive.service.config.overrides import parse_changes
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, ReplayResult, Source, require_calibration
from semlive.service.replay.replay import replay as replay_log


class EstimationMethod(StrEnum):
    """Methods of estimation."""

    JOINT = "joint"
    SUTTON2007 = "sutton2007"


def replay(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    method: Annotated[
        EstimationMethod | None, typer.Option(help="Method of estimation; by default that of the configuration in the log.")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="Model of effects that are corrected in the maps, as `diagnose -o` writes it.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value, as in dic.subset=31; may be repeated.")] = None,
    from_images: Annotated[
        bool, typer.Option("--from-images", help="Correlate the images again; the default for logs with images.")
    ] = False,
    from_disparity: Annotated[
        bool, typer.Option("--from-disparity", help="Start from the disparity maps in the log; the default for imported logs.")
    ] = False,
    until: Annotated[int | None, typer.Option(help="Number of the last pair to use.", min=0)] = None,
    speed: Annotated[
        float | None, typer.Option(help="Play the log at this multiple of the recorded speed, and show results as they arrive.")
    ] = None,
    as_fast_as_possible: Annotated[bool, typer.Option("--max", help="As fast as possible; the default.")] = False,
) -> None:
    """Repeat the analysis of a log and compare the result with the one that the live run recorded."""
    if from_images and from_disparity:
        raise BadInput("--from-images and --from-disparity: give only one of them.")
    if speed is not None and (as_fast_as_possible or not speed > 0):
        raise BadInput(f"--speed {speed:g}: give a number above 0, and leave --max out.")
    if model is not None and from_images:
        raise BadInput(f"--model {model}: its effects are fitted to the log's disparity maps; leave --from-images out.")
    source = Source.IMAGES if from_images else Source.DISPARITY if from_disparity else None
    request = ReplayRequest(log, method.value if method else None, parse_changes(settings or []), source, until, speed, model)
    console = Console()
    with multi_stage_progress(hidden=speed is not None) as progress:
        follow = None if speed is None else lambda decision, state: console.print(pair_status_line(decision, state), highlight=False)
        replayed = replay_log(request, ReplayCallbacks(progress, None if as_json else follow, lambda _: None))
    require_calibration(log, replayed)
    result = result_json(replayed.result, replayed.settings)
    if as_json:
        typer.echo(json.dumps(result))
        return
    console.print(result_table(replayed.result))
    _compare(console, request, replayed, result)


def _compare(console: Console, request: ReplayRequest, replayed: ReplayResult, result: dict[str, Any]) -> None:
    """Print whether the result equals the recorded one; after changes of settings print a table of the differences."""
    if not replayed.unchanged:
        recorded, label = replayed.recorded, "recorded"
        if recorded is None:
            unchanged = replay_log(ReplayRequest(request.log, source=request.source), ReplayCallbacks(frame=lambda _: None))
            recorded, label = result_json(unchanged.result, unchanged.settings), "log's own settings"
        console.print(comparison_table(recorded, result, label))
    elif replayed.recorded is None:
        imported = replayed.result.decisions[0].first.origin is FrameOrigin.IMPORTED
        reason = "it was imported" if imported else "the run was interrupted"
        console.print(f"the log holds no final result to compare with: {reason}")
    elif differing := json_differences(replayed.recorded, result):
        console.print(f"live and replayed results differ in {len(differing)} values, the first is {differing[0]}")
    else:
        console.print("live and replayed results are identical")
