"""Retention of runs: selection and deletion of run folders that exceed the limits.

A run is retained if its log may still be needed: an incomplete run can be resumed, other files in the folder may be of value, and a running
or damaged run cannot be assessed. Only complete run folders are deleted.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, ChunkIndex, Message

from semlive.engine import State
from semlive.errors import BadConfig, BadInput, SemliveError
from semlive.formats.log.segment_scan import scan_spans, summary
from semlive.inputs.files import open_regular
from semlive.inputs.json_text import parse_json
from semlive.service.log.files import PARTIAL_SUFFIX, SUFFIX, segments
from semlive.service.log.lock import run_lock
from semlive.service.log.recording import sync_folder

_DELETING = ".deleting"
_DAY_S = 86_400.0
_AHEAD_S = 60.0  # tolerated difference between the clocks of a file server and of this computer


@dataclass(frozen=True, slots=True)
class Retention:
    """Limits of the retention of runs; None sets no limit.

    Attributes:
        days: largest age, from the last write to the log.
        gb: largest total size of all runs, 10^9 bytes; the oldest runs are deleted first.
    """

    days: float | None = None
    gb: float | None = None


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A stored run.

    Attributes:
        folder: run folder.
        size: total size of its files, bytes.
        ended_s: time of the last write to its files, seconds since 1970.
        retained_because: reason for retention regardless of the limits; None if it may be deleted.
        deleted_because: the limit that it exceeds; None if it is retained.
    """

    folder: Path
    size: int
    ended_s: float
    retained_because: str | None
    deleted_because: str | None = None


def select_runs(root: Path, limits: Retention, now_s: float) -> tuple[StoredRun, ...]:
    """Return all runs of a folder of logs, the oldest first, with the limits that they exceed.

    Args:
        root: folder of run folders, `run.folder` of the configuration.
        limits: limits of the retention.
        now_s: this computer's time, seconds since 1970.

    Raises:
        BadConfig: there is no such folder.
    """
    if not root.is_dir():
        raise BadConfig(f"{root}: no such folder; give the folder in which runs are written (run.folder)")
    runs = sorted((_check_run(folder, now_s) for folder in _run_folders(root)), key=lambda run: (run.ended_s, run.folder.name))
    total, checked = sum(run.size for run in runs), list[StoredRun]()
    for run in runs:
        reason = None if run.retained_because else _exceeded_limit(run, limits, now_s, total)
        total -= 0 if reason is None else run.size
        checked.append(StoredRun(run.folder, run.size, run.ended_s, run.retained_because, reason))
    return tuple(checked)


def delete(run: StoredRun, now_s: float) -> None:
    """Delete a run that exceeds a limit; after an interruption it exists completely or not at all.

    Raises:
        BadInput: the run must be retained in its present state.
        SemliveError: the system refused.
    """
    with run_lock(run.folder):
        now = _check_run(run.folder, now_s, is_locked=True)
        if now.retained_because or now.ended_s != run.ended_s:
            raise BadInput(f"{run.folder}: is kept: {now.retained_because or 'it has just been written to'}")
        away = run.folder.with_name(f".{run.folder.name}{_DELETING}")
        try:
            run.folder.rename(away)
            sync_folder(run.folder.parent)
            shutil.rmtree(away)
        except OSError as error:
            raise SemliveError(f"{run.folder}: cannot be deleted ({error.strerror}); check its permissions") from error


def finish_deleting(root: Path) -> None:
    """Complete interrupted deletions."""
    for folder in root.glob(f".*{_DELETING}"):
        if folder.is_dir() and not folder.is_symlink():
            shutil.rmtree(folder, ignore_errors=True)


def _run_folders(root: Path) -> Iterator[Path]:
    for folder in sorted(root.iterdir()):
        if folder.is_dir() and not folder.is_symlink() and not folder.name.startswith("."):
            names = [path.name.removesuffix(PARTIAL_SUFFIX) for path in folder.iterdir()]
            if any(_is_segment(name, folder.name) for name in names):
                yield folder


def _is_segment(name: str, run: str) -> bool:
    return re.fullmatch(re.escape(run) + r"\.\d{3,}" + re.escape(SUFFIX), name) is not None


def _check_run(folder: Path, now_s: float, is_locked: bool = False) -> StoredRun:
    states = [path.lstat() for path in folder.iterdir()]
    size, ended_s = sum(state.st_size for state in states), max(state.st_mtime for state in states)
    return StoredRun(folder, size, ended_s, _retention_reason(folder, ended_s, now_s, is_locked))


def _retention_reason(folder: Path, ended_s: float, now_s: float, is_locked: bool) -> str | None:
    names = sorted(path.name for path in folder.iterdir())
    if any(name.endswith(PARTIAL_SUFFIX) for name in names):
        return "it was not finished"
    other_names = [name for name in names if not _is_segment(name, folder.name)]
    if other_names:
        return f"it holds {other_names[0]} in addition to its log"
    if ended_s > now_s + _AHEAD_S:
        return "it is newer than this computer's clock"
    if not is_locked:
        try:
            with run_lock(folder):
                pass
        except BadConfig:
            return "semlive is at work on it"
    try:
        state, result_after = _end_of(folder)
    except (OSError, SemliveError, ValueError, KeyError, TypeError):
        return "its log is damaged"
    if state != State.COMPLETE or not result_after:
        return "it is not complete and can be resumed"
    return None


def _end_of(folder: Path) -> tuple[str, bool]:
    """Return the last protocol state and whether a result follows it, from the indexes at the ends of the segments."""
    result_ns = -1
    for path in reversed(segments(folder)):
        with open_regular(path) as stream:
            records = summary(stream)
            if not records:
                raise BadInput(f"{path}: has no index")
            topics = {record.id: record.topic for record in records if isinstance(record, Channel)}
            chunks = sorted((record for record in records if isinstance(record, ChunkIndex)), key=lambda chunk: -chunk.chunk_start_offset)
            for chunk in chunks:
                if not {topics.get(number) for number in chunk.message_index_offsets} & {"/state", "/result"}:
                    continue
                span = next(scan_spans(stream, chunk.chunk_start_offset))
                for message in reversed([record for record in span.records if isinstance(record, Message)]):
                    topic = topics.get(message.channel_id)
                    if topic == "/result":
                        result_ns = max(result_ns, message.log_time)
                    elif topic == "/state":
                        return str(parse_json(message.data)["after"]), result_ns > message.log_time
    return "", False


def _exceeded_limit(run: StoredRun, limits: Retention, now_s: float, total: int) -> str | None:
    age_days = (now_s - run.ended_s) / _DAY_S
    if limits.days is not None and age_days > limits.days:
        return f"it ended {age_days:.0f} days ago"
    if limits.gb is not None and total > limits.gb * 1e9:
        return f"all runs from it on take {total / 1e9:.1f} GB"
    return None


def free_bytes(root: Path) -> int:
    """Return the free space on the disk, bytes."""
    return shutil.disk_usage(os.fspath(root)).free
