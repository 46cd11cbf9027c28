"""`semlive replay`: the analysis again, from a log."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from semlive.cli.progress_bar import multi_stage_progress
from semlive.cli.tables import comparison_table, pair_status_line, result_table
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
        EstimationMethod | None, typer.Option(help="Method of estimation; by default the one that the run's configuration names.")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="A model with further effects, as `diagnose` writes it.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="key=value, as in dic.subset=31; may be given again.")] = None,
    from_images: Annotated[
        bool, typer.Option("--from-images", help="Correlate the images again: the default where there are any.")
    ] = False,
    from_disparity: Annotated[
        bool, typer.Option("--from-disparity", help="Start from the disparity maps in the log: the default for imported logs.")
    ] = False,
    until: Annotated[int | None, typer.Option(help="Number of the last pair to take.", min=0)] = None,
    speed: Annotated[float | None, typer.Option(help="Play at this many times the speed of life, results as they come.")] = None,
    as_fast_as_possible: Annotated[bool, typer.Option("--max", help="As fast as it goes: the default.")] = False,
) -> None:
    """Recompute the analysis from a log and compare it with what the live run recorded."""
    if from_images and from_disparity:
        raise BadInput("--from-images and --from-disparity: give one of them.")
    if speed is not None and (as_fast_as_possible or not speed > 0):
        raise BadInput(f"--speed {speed:g}: give a number above 0, and not --max with it.")
    if model is not None and from_images:
        raise BadInput(f"--model {model}: its effects are fitted to the log's disparity maps; leave --from-images out.")
    source = Source.IMAGES if from_images else Source.DISPARITY if from_disparity else None
    asked = ReplayRequest(log, method.value if method else None, parse_changes(settings or []), source, until, speed, model)
    console = Console()
    with multi_stage_progress(quiet=speed is not None) as progress:
        follow = None if speed is None else lambda decision, begun: console.print(pair_status_line(decision, begun), highlight=False)
        done = replay_log(asked, ReplayCallbacks(progress, None if as_json else follow, lambda _: None))
    require_calibration(log, done)
    result = result_json(done.result, done.settings)
    if as_json:
        typer.echo(json.dumps(result))
        return
    console.print(result_table(done.result))
    _compare(console, asked, done, result)


def _compare(console: Console, asked: ReplayRequest, done: ReplayResult, result: dict[str, Any]) -> None:
    """Say whether the result is the recorded one, or what the changes did to it."""
    if not done.unchanged:
        recorded, beside = done.recorded, "recorded"
        if recorded is None:
            own = replay_log(ReplayRequest(asked.log, source=asked.source), ReplayCallbacks(frame=lambda _: None))
            recorded, beside = result_json(own.result, own.settings), "log's own settings"
        console.print(comparison_table(recorded, result, beside))
    elif done.recorded is None:
        imported = done.result.decisions[0].first.origin is FrameOrigin.IMPORTED
        why = "it was imported" if imported else "the run did not end by itself"
        console.print(f"the log holds no final result to compare with: {why}")
    elif differing := json_differences(done.recorded, result):
        console.print(f"live and replayed results differ in {len(differing)} values, the first {differing[0]}")
    else:
        console.print("live and replayed results are identical")
