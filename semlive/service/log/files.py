"""Logs as files: `LOG` is one MCAP file, or a run folder of segments ``<run>.000.mcap``, ``<run>.001.mcap``, ..."""

from __future__ import annotations

import heapq
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from semlive.errors import BadLog
from semlive.formats.log.reader import LogMessage, read_messages, rewritten_after
from semlive.inputs.files import open_regular

SUFFIX = ".mcap"
PARTIAL_SUFFIX = ".part"


def log_name(log: Path) -> str:
    """Return the name of a log: its folder, or its file without the suffix. The name of a run may contain dots."""
    name = log.name if log.name.strip(".") else log.resolve().name
    return name if log.is_dir() else name.removesuffix(PARTIAL_SUFFIX).removesuffix(SUFFIX)


def sibling_path(log: Path, ending: str) -> Path:
    """Return the path of a file next to a log, with the name of the log before its ending."""
    place = log if log.name.strip(".") else log.resolve()
    return place.with_name(log_name(log) + ending)


def segment_path(folder: Path, run: str, segment: int) -> Path:
    """Return the path of a finished segment of a run; a growing segment has `PARTIAL_SUFFIX` appended."""
    return folder / f"{run}.{segment:03d}{SUFFIX}"


def next_segment(path: Path) -> Path:
    """Return the path of the segment after this one."""
    run, _, number = path.name.removesuffix(SUFFIX).rpartition(".")
    return segment_path(path.parent, run, int(number) + 1)


def segments(log: Path) -> tuple[Path, ...]:
    """Return the files of a log in order, with segments that are not finished (killed, or still growing).

    Raises:
        BadLog: there is no such log, or the folder holds no segment or segments of several runs.
    """
    if log.is_file():
        return (log,)
    if not log.is_dir():
        raise BadLog(f"{log}: no such log; give an MCAP file or a run folder.")
    listed, previous = _listed(log), None
    while previous is None or listed.keys() != previous.keys():
        # A file that is being renamed may be missed by a listing.
        listed, previous = _listed(log), listed
    if not listed:
        raise BadLog(f"{log}: holds no {SUFFIX} file; give an MCAP file or a run folder.")
    runs = sorted({name.removesuffix(SUFFIX).rpartition(".")[0] for name in listed})
    if len(runs) > 1:
        raise BadLog(f"{log}: holds several logs ({', '.join(listed)}); give one of them.")
    # Segment 1000 has four digits.
    return tuple(listed[name] for name in sorted(listed, key=lambda name: (len(name), name)))


def _listed(folder: Path) -> dict[str, Path]:
    """Return the segments by their finished names."""
    files: dict[str, Path] = {}
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if entry.name.removesuffix(PARTIAL_SUFFIX).endswith(SUFFIX) and entry.is_file())
    except FileNotFoundError as error:  # another run has just replaced the folder
        raise BadLog(f"{folder}: no such log; give an MCAP file or a run folder.") from error
    for name in names:
        # A finished segment takes precedence over the unfinished file of the same segment.
        files.setdefault(name.removesuffix(PARTIAL_SUFFIX), folder / name)
    return files


def messages(log: Path, on_damage: Callable[[str], None] | None = None) -> Iterator[LogMessage]:
    """Yield all messages of a log in the order in which they were written.

    Messages that a segment repeats, because the disk had not acknowledged them in the preceding one, are yielded once, from either segment.

    Args:
        log: one MCAP file, or a run folder.
        on_damage: callback with one sentence for each damage that was skipped.

    Raises:
        BadLog: there is no such log, or a file of it cannot be read or is not MCAP.
    """
    paths, pending = segments(log), list[LogMessage]()
    for place, path in enumerate(paths):
        repeated_after = _repeated_after(paths[place + 1]) if place + 1 < len(paths) else None
        merged, pending = _merged(pending, _segment(path, on_damage)), []
        for message in merged:
            if repeated_after is not None and message.log_time_ns > repeated_after:
                pending.append(message)
            else:
                yield message
    yield from pending


def _repeated_after(path: Path) -> int | None:
    try:
        with open_segment(path) as stream:
            return rewritten_after(stream)
    except (OSError, BadLog):
        return None  # the reader of the segment itself reports the error


def _merged(pending: list[LogMessage], segment: Iterable[LogMessage]) -> Iterator[LogMessage]:
    """Merge the messages of a segment with those of the preceding one, each log time once."""
    if not pending:
        yield from segment
        return
    newest = -1
    for message in heapq.merge(pending, segment, key=lambda item: item.log_time_ns):
        if message.log_time_ns > newest:
            yield message
        newest = max(newest, message.log_time_ns)


def _segment(path: Path, on_damage: Callable[[str], None] | None) -> Iterator[LogMessage]:
    def report(damage: str) -> None:
        if on_damage is not None:
            on_damage(f"{path.name}: {damage}.")

    try:
        with open_segment(path) as stream:
            yield from read_messages(stream, report)
    except OSError as exc:
        raise BadLog(f"{path}: cannot be read ({exc.strerror}); check the file and its permissions.") from exc
    except BadLog as exc:
        raise BadLog(f"{path}: {exc}") from exc


def open_segment(path: Path) -> BinaryIO:
    """Open a segment, under its finished name if it was finished since it was listed."""
    try:
        return open_regular(path)
    except FileNotFoundError:
        return open_regular(path.with_name(path.name.removesuffix(PARTIAL_SUFFIX)))
