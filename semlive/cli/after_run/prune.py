"""`semlive prune`: list the old runs beyond a limit, and delete them with --delete."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.shared.terminal import echo
from semlive.errors import BadConfig, SemliveError
from semlive.service.log.retention import Retention, StoredRun, delete, finish_deleting, free_bytes, select_runs


def prune(
    folder: Annotated[Path, typer.Argument(help="Folder of run folders: run.folder of the configuration.")],
    days: Annotated[
        float | None, typer.Option(min=0.0, help="Limit of age: runs that ended more than this many days ago are beyond it.")
    ] = None,
    gb: Annotated[
        float | None,
        typer.Option(min=0.0, help="Limit of size in 10^9 bytes: the oldest runs are beyond it until the others take no more."),
    ] = None,
    do_delete: Annotated[bool, typer.Option("--delete", help="Delete these runs; without it they are only listed.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List old runs beyond a limit, and delete them with --delete; a run that is incomplete or holds other files is always kept."""
    if days is None and gb is None:
        raise BadConfig("semlive prune: no limit is given; add --days or --gb")
    now_s = time.time()
    if do_delete and folder.is_dir():
        finish_deleting(folder)
    runs = select_runs(folder, Retention(days, gb), now_s)
    deleted, refused = set[Path](), list[str]()
    for run in runs if do_delete else ():
        if run.deleted_because:
            try:
                delete(run, now_s)
                deleted.add(run.folder)
            except SemliveError as error:
                refused.append(str(error))
    if as_json:
        typer.echo(json.dumps({"runs": [_as_json(run, run.folder in deleted) for run in runs], "free_bytes": free_bytes(folder)}))
    else:
        for run in runs:
            echo(_line(run, run.folder in deleted))
        echo(_sum(runs, deleted, do_delete))
    if refused:
        raise SemliveError("; ".join(refused))


def _as_json(run: StoredRun, deleted: bool) -> dict[str, object]:
    return {
        "run": str(run.folder),
        "bytes": run.size,
        "ended": _utc(run.ended_s),
        "kept_because": run.retained_because,
        "beyond": run.deleted_because,
        "deleted": deleted,
    }


def _line(run: StoredRun, deleted: bool) -> str:
    prefix = f"{run.folder.name}: {run.size / 1e9:.2f} GB, {_utc(run.ended_s)}, "
    if run.retained_because:
        return f"{prefix}kept: {run.retained_because}"
    if run.deleted_because:
        return f"{prefix}{'deleted' if deleted else 'would be deleted'}: {run.deleted_because}"
    return f"{prefix}kept: within the limits"


def _sum(runs: tuple[StoredRun, ...], deleted: set[Path], do_delete: bool) -> str:
    beyond = [run for run in runs if (run.folder in deleted if do_delete else run.deleted_because)]
    size_gb = sum(run.size for run in beyond) / 1e9
    if do_delete:
        return f"{len(beyond)} runs deleted, {size_gb:.2f} GB"
    return f"{len(beyond)} runs would be deleted, {size_gb:.2f} GB" + ("; add --delete to delete them" if beyond else "")


def _utc(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).isoformat(timespec="seconds")
