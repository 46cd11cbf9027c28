"""`semlive recover`: repair a truncated or damaged log."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.shared.output_path import output_folder
from semlive.cli.shared.progress_bar import progress_bar
from semlive.cli.shared.terminal import echo
from semlive.service.log.repair import Damage, RepairSummary, recover_log


def recover(
    log: Annotated[Path, typer.Argument(help="One MCAP file, finished or not, or a run folder of segments.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Path of the repaired log; by default it replaces the log, and each damaged original is kept in the same folder.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Repair a truncated or damaged log: keep every complete message, write an index, and list what was lost."""
    if out is not None:
        output_folder(out.parent, "--out")
    with progress_bar("recovering", "MB") as progress:
        recovered = recover_log(log, out, lambda done, size: progress(done >> 20, size >> 20))
    if as_json:
        typer.echo(json.dumps(_as_json(recovered)))
        return
    for segment in recovered:
        for line in _lines(segment):
            echo(line)


def _as_json(recovered: tuple[RepairSummary, ...]) -> dict[str, object]:
    return {
        "messages": sum(sum(segment.recovered.values()) for segment in recovered),
        "lost": sum(sum(segment.lost.values()) for segment in recovered),
        "lost_is_complete": all(segment.lost_is_complete for segment in recovered),
        "segments": [
            {
                "source": str(segment.source),
                "log": str(segment.path),
                "kept_as": None if segment.original is None else str(segment.original),
                "whole": segment.was_intact,
                "kept": dict(segment.recovered),
                "lost": dict(segment.lost),
                "lost_is_complete": segment.lost_is_complete,
                "damage": [
                    {
                        "start_byte": damage.start_byte,
                        "end_byte": damage.end_byte,
                        "what": damage.what,
                        "after_ns": damage.after_ns,
                        "before_ns": damage.before_ns,
                        "lost": dict(damage.lost),
                    }
                    for damage in segment.damage
                ],
            }
            for segment in recovered
        ],
    }


def _lines(segment: RepairSummary) -> list[str]:
    messages = sum(segment.recovered.values())
    if segment.was_intact:
        return [f"{segment.path}: intact, {messages} messages"]
    lines = [
        f"{segment.path}: recovered, {messages} messages"
        + ("" if segment.original is None else f"; the original is {segment.original.name}")
    ]
    lines += [f"  {_damage_line(damage)}" for damage in segment.damage]
    lost = ", ".join(f"{count} of {topic}" for topic, count in segment.lost.items())
    if segment.lost_is_complete:
        lines.append(f"  lost: {lost or 'nothing'}")
    else:
        lines.append(f"  lost: {lost or 'no counted message'}; messages behind the point of truncation, or never written, are not counted")
    return lines


def _damage_line(damage: Damage) -> str:
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
