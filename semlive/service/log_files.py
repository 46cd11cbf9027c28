"""Logs as files: `LOG` is one MCAP file, or a run folder of segments ``<run>.000.mcap``, ``<run>.001.mcap``, ..."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from semlive.errors import BadLog
from semlive.formats.log import LogMessage, read_messages

SUFFIX = ".mcap"
PART = ".part"


def segment_path(folder: Path, run: str, segment: int) -> Path:
    """Where a segment of a run is kept when it is finished; while it grows it has `PART` behind."""
    return folder / f"{run}.{segment:03d}{SUFFIX}"


def segments(log: Path) -> tuple[Path, ...]:
    """The files of a log in order; a segment that was not finished (killed, or still growing) counts.

    Raises:
        BadLog: there is no such log, or the folder holds no segment or segments of several runs.
    """
    if log.is_file():
        return (log,)
    if not log.is_dir():
        raise BadLog(f"{log}: no such log; give an MCAP file or a run folder.")
    found: dict[str, Path] = {}
    for path in sorted(log.iterdir()):
        name = path.name.removesuffix(PART)
        if name.endswith(SUFFIX) and path.is_file():
            # A finished segment comes before its own remains.
            found.setdefault(name, path)
    if not found:
        raise BadLog(f"{log}: holds no {SUFFIX} file; give an MCAP file or a run folder.")
    runs = sorted({name.removesuffix(SUFFIX).rpartition(".")[0] for name in found})
    if len(runs) > 1:
        raise BadLog(f"{log}: holds several logs ({', '.join(found)}); give one of them.")
    return tuple(found[name] for name in sorted(found))


def messages(log: Path, on_damage: Callable[[str], None] | None = None) -> Iterator[LogMessage]:
    """All messages of a log in the order in which they were written.

    Args:
        log: one MCAP file, or a run folder.
        on_damage: told one sentence for each damage that was passed over.

    Raises:
        BadLog: there is no such log, or a file of it cannot be read or is not MCAP.
    """
    for path in segments(log):
        yield from _segment(path, on_damage)


def _segment(path: Path, on_damage: Callable[[str], None] | None) -> Iterator[LogMessage]:
    def tell(what: str) -> None:
        if on_damage is not None:
            on_damage(f"{path.name}: {what}.")

    try:
        with _opened(path) as stream:
            yield from read_messages(stream, tell)
    except OSError as exc:
        raise BadLog(f"{path}: cannot be read ({exc.strerror}); check the file and its permissions.") from exc
    except BadLog as exc:
        raise BadLog(f"{path}: {exc}") from exc


def _opened(path: Path) -> BinaryIO:
    """The segment, under its finished name if it was finished since it was listed."""
    try:
        return path.open("rb")
    except FileNotFoundError:
        return path.with_name(path.name.removesuffix(PART)).open("rb")
