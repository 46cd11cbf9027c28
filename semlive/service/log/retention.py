"""Which runs in a folder of logs may be deleted, and deleting them.

A run of whose log anything could still be needed is kept: one that is not complete can be taken up again, one with other files beside its
log means something to somebody, one that is at work or damaged is nobody's to judge. Nothing but whole run folders is deleted.
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
from semlive.formats.log.repair import scan_spans, summary
from semlive.inputs.files import open_regular
from semlive.inputs.json_text import parse_json
from semlive.service.log.files import PARTIAL_SUFFIX, SUFFIX, segments
from semlive.service.log.lock import run_lock
from semlive.service.log.stream import sync_folder

_DELETING = ".deleting"
_DAY_S = 86_400.0
_AHEAD_S = 60.0  # clocks of a file server and of this computer are never quite the same


@dataclass(frozen=True, slots=True)
class Retention:
    """How long runs are kept; what is None sets no limit.

    Attributes:
        days: since the last byte of the log was written.
        gb: 10^9 bytes of all runs together; the oldest go first.
    """

    days: float | None = None
    gb: float | None = None


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A run folder.

    Attributes:
        folder: of the run.
        size: of all its files, bytes.
        ended_s: when its newest file was written, seconds since 1970.
        kept_because: why it must be kept whatever the limits; None if it may be deleted.
        deleted_because: which limit it exceeds; None if it stays.
    """

    folder: Path
    size: int
    ended_s: float
    kept_because: str | None
    deleted_because: str | None = None


def select_runs(root: Path, limits: Retention, now_s: float) -> tuple[StoredRun, ...]:
    """All runs of a folder of logs, the oldest first, and which of them exceed the limits.

    Args:
        root: folder of run folders, `run.folder` of the configuration.
        limits: how long runs are kept.
        now_s: this computer's time, seconds since 1970.

    Raises:
        BadConfig: there is no such folder.
    """
    if not root.is_dir():
        raise BadConfig(f"{root}: no such folder; give the folder in which runs are written (run.folder)")
    runs = sorted((_looked_at(folder, now_s) for folder in _run_folders(root)), key=lambda one: (one.ended_s, one.folder.name))
    total, judged = sum(one.size for one in runs), list[StoredRun]()
    for one in runs:
        why = None if one.kept_because else _beyond(one, limits, now_s, total)
        total -= 0 if why is None else one.size
        judged.append(StoredRun(one.folder, one.size, one.ended_s, one.kept_because, why))
    return tuple(judged)


def delete(run: StoredRun, now_s: float) -> None:
    """Delete a run that exceeds a limit; it is there whole or not at all, whenever this is broken off.

    Raises:
        BadInput: it must be kept, as it is now.
        SemliveError: the system refused.
    """
    with run_lock(run.folder):
        now = _looked_at(run.folder, now_s, held=True)
        if now.kept_because or now.ended_s != run.ended_s:
            raise BadInput(f"{run.folder}: is kept: {now.kept_because or 'it has just been written to'}")
        away = run.folder.with_name(f".{run.folder.name}{_DELETING}")
        try:
            run.folder.rename(away)
            sync_folder(run.folder.parent)
            shutil.rmtree(away)
        except OSError as error:
            raise SemliveError(f"{run.folder}: cannot be deleted ({error.strerror}); look at its permissions") from error


def finish_deleting(root: Path) -> None:
    """Go on with what was broken off when it was being deleted."""
    for folder in root.glob(f".*{_DELETING}"):
        if folder.is_dir() and not folder.is_symlink():
            shutil.rmtree(folder, ignore_errors=True)


def _run_folders(root: Path) -> Iterator[Path]:
    for folder in sorted(root.iterdir()):
        if folder.is_dir() and not folder.is_symlink() and not folder.name.startswith("."):
            names = [one.name.removesuffix(PARTIAL_SUFFIX) for one in folder.iterdir()]
            if any(_is_segment(name, folder.name) for name in names):
                yield folder


def _is_segment(name: str, run: str) -> bool:
    return re.fullmatch(re.escape(run) + r"\.\d{3,}" + re.escape(SUFFIX), name) is not None


def _looked_at(folder: Path, now_s: float, held: bool = False) -> StoredRun:
    states = [one.lstat() for one in folder.iterdir()]
    size, ended_s = sum(one.st_size for one in states), max(one.st_mtime for one in states)
    return StoredRun(folder, size, ended_s, _must_be_kept(folder, ended_s, now_s, held))


def _must_be_kept(folder: Path, ended_s: float, now_s: float, held: bool) -> str | None:
    names = sorted(one.name for one in folder.iterdir())
    if any(name.endswith(PARTIAL_SUFFIX) for name in names):
        return "it was not finished"
    others = [name for name in names if not _is_segment(name, folder.name)]
    if others:
        return f"it holds {others[0]} beside its log"
    if ended_s > now_s + _AHEAD_S:
        return "it is newer than this computer's clock"
    if not held:
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
        return "it did not get to its end and can be taken up again"
    return None


def _end_of(folder: Path) -> tuple[str, bool]:
    """The protocol's last state, and whether the result was written after it; from the ends of the segments, by their indexes."""
    result_ns = -1
    for path in reversed(segments(folder)):
        with open_regular(path) as stream:
            records = summary(stream)
            if not records:
                raise BadInput(f"{path}: has no index")
            topics = {one.id: one.topic for one in records if isinstance(one, Channel)}
            chunks = sorted((one for one in records if isinstance(one, ChunkIndex)), key=lambda one: -one.chunk_start_offset)
            for chunk in chunks:
                wanted = {topics.get(number) for number in chunk.message_index_offsets} & {"/state", "/result"}
                if not wanted:
                    continue
                piece = next(scan_spans(stream, chunk.chunk_start_offset))
                for message in reversed([one for one in piece.records if isinstance(one, Message)]):
                    topic = topics.get(message.channel_id)
                    if topic == "/result":
                        result_ns = max(result_ns, message.log_time)
                    elif topic == "/state":
                        return str(parse_json(message.data)["after"]), result_ns > message.log_time
    return "", False


def _beyond(run: StoredRun, limits: Retention, now_s: float, total: int) -> str | None:
    age_days = (now_s - run.ended_s) / _DAY_S
    if limits.days is not None and age_days > limits.days:
        return f"it ended {age_days:.0f} days ago"
    if limits.gb is not None and total > limits.gb * 1e9:
        return f"all runs from it on take {total / 1e9:.1f} GB"
    return None


def free_bytes(root: Path) -> int:
    """Room that is left on the disk."""
    return shutil.disk_usage(os.fspath(root)).free
