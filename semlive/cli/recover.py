"""`semlive recover`: a torn or damaged log made valid again."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from semlive.cli.progress_bar import progress_bar
from semlive.cli.terminal import echo
from semlive.service.log.repair import Damage, RepairSummary, recover_log


def recover(
    log: Annotated[Path, typer.Argument(help="One MCAP file, finished or not, or a run folder of segments.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Where the valid log goes; by default in place, and each damaged original is kept beside it."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Make a torn or damaged log valid: all that is whole, with an index, and a list of what was lost."""
    with progress_bar("recovering", "MB") as progress:
        recovered = recover_log(log, out, lambda done, size: progress(done >> 20, size >> 20))
    if as_json:
        typer.echo(json.dumps(_as_json(recovered)))
        return
    for one in recovered:
        for line in _lines(one):
            echo(line)


def _as_json(recovered: tuple[RepairSummary, ...]) -> dict[str, Any]:
    return {
        "messages": sum(sum(one.recovered.values()) for one in recovered),
        "lost": sum(sum(one.lost.values()) for one in recovered),
        "lost_is_complete": all(one.lost_is_complete for one in recovered),
        "segments": [
            {
                "source": str(one.source),
                "log": str(one.path),
                "kept_as": None if one.original is None else str(one.original),
                "whole": one.was_intact,
                "kept": dict(one.recovered),
                "lost": dict(one.lost),
                "lost_is_complete": one.lost_is_complete,
                "damage": [
                    {
                        "start_byte": damage.start_byte,
                        "end_byte": damage.end_byte,
                        "what": damage.what,
                        "after_ns": damage.after_ns,
                        "before_ns": damage.before_ns,
                        "lost": dict(damage.lost),
                    }
                    for damage in one.damage
                ],
            }
            for one in recovered
        ],
    }


def _lines(one: RepairSummary) -> list[str]:
    messages = sum(one.recovered.values())
    if one.was_intact:
        return [f"{one.path}: whole, {messages} messages"]
    lines = [f"{one.path}: recovered, {messages} messages" + ("" if one.original is None else f"; the original is {one.original.name}")]
    lines += [f"  {_told(damage)}" for damage in one.damage]
    lost = ", ".join(f"{count} of {topic}" for topic, count in one.lost.items())
    if one.lost_is_complete:
        lines.append(f"  lost: {lost or 'nothing'}")
    else:
        lines.append(f"  lost: {lost or 'no message that is known of'}; what was never written, or stood behind the tear, is not counted")
    return lines


def _told(damage: Damage) -> str:
    place = f"bytes {damage.start_byte} to {damage.end_byte}: " if damage.end_byte > damage.start_byte else ""
    if damage.after_ns is not None and damage.before_ns is not None:
        gap = f", {(damage.before_ns - damage.after_ns) / 1e9:.3f} s from {_utc(damage.after_ns)}"
    elif damage.after_ns is not None:
        gap = f", after {_utc(damage.after_ns)}"
    else:
        gap = ""
    return f"{place}{damage.what}{gap}"


def _utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).isoformat(timespec="milliseconds")
