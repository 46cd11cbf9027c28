"""Repair of truncated and damaged logs, with an account of the losses.

The repair deletes no data: a damaged segment is stored with the recovered one under another name. At every time during a repair, even after
a kill, the folder contains a readable log.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Message, MessageIndex, Metadata, Schema, Statistics

from semlive.errors import BadLog, SemliveError
from semlive.formats.log.messages import RAW_TOPICS, TOPICS
from semlive.formats.log.reader import rewritten_in
from semlive.formats.log.segment_scan import SegmentSpan, channels_and_schemas, scan_spans, summary
from semlive.formats.log.writer import LogWriter
from semlive.inputs.files import open_regular
from semlive.service.log.files import PARTIAL_SUFFIX, SUFFIX, segments
from semlive.service.log.recording import REWRITING, is_being_written, sync_folder

ORIGINAL = ".original"
_GROWING = ".recovering"


@dataclass(frozen=True, slots=True)
class Damage:
    """One damaged part of a segment.

    Attributes:
        start_byte: first damaged byte.
        end_byte: byte after the last.
        what: description of the damage, a clause.
        after_ns: log time of the last message before the damage; None if there is none.
        before_ns: log time of the first message after the damage; None if there is none.
        lost: number of lost messages of each topic, from the index after the damage; empty without an index.
    """

    start_byte: int
    end_byte: int
    what: str
    after_ns: int | None
    before_ns: int | None
    lost: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class RepairSummary:
    """Result of the repair of one segment.

    Attributes:
        source: the segment before the repair.
        path: the valid segment.
        original: new path of the damaged original; None if it was intact or was not moved.
        recovered: number of messages of each topic in the valid segment.
        lost: number of lost messages of each topic, as far as known.
        lost_is_complete: `lost` contains all losses; otherwise there may be more, after a truncation or in topics without a count.
        damage: damaged parts in order; empty if the segment was intact.
    """

    source: Path
    path: Path
    original: Path | None
    recovered: Mapping[str, int]
    lost: Mapping[str, int]
    lost_is_complete: bool
    damage: tuple[Damage, ...]

    @property
    def was_intact(self) -> bool:
        """Whether the segment was intact."""
        return not self.damage


def recover_log(log: Path, out: Path | None = None, progress: Callable[[int, int], object] = lambda *_: None) -> tuple[RepairSummary, ...]:
    """Make every segment of a log valid.

    Args:
        log: one file, or a run folder.
        out: destination of the valid log: a file for a file, a folder for a folder; None repairs each segment in place.
        progress: callback with the number of bytes read and the total.

    Raises:
        BadLog: there is no such log, it is no MCAP file, it is being written, or `out` exists.
        SemliveError: it cannot be read or written.
    """
    if out is None and log.is_dir():
        _adopt_rewriting(log)
    paths = segments(log)
    sizes = {path: path.stat().st_size for path in paths}

    def recovered(path: Path, target: Path | None) -> RepairSummary:
        before = sum(sizes[segment] for segment in paths[: paths.index(path)])
        return recover_segment(path, target, lambda done: progress(before + done, sum(sizes.values())))

    if out is None:
        return tuple(recovered(path, None) for path in paths)
    if out.exists():
        raise BadLog(f"{out}: exists already; name another file or folder.")
    if log.is_file():
        return (recovered(paths[0], out),)
    out.mkdir(parents=True)
    return tuple(recovered(path, out / path.name.removesuffix(PARTIAL_SUFFIX)) for path in paths)


def repair_partial_segments(folder: Path) -> tuple[RepairSummary, ...]:
    """Convert every ``.part`` file of a run folder to a valid segment.

    Raises:
        BadLog: a segment is being written by another semlive.
        SemliveError: a segment cannot be read or written.
    """
    _adopt_rewriting(folder)
    parts = sorted(folder.glob(f"*{SUFFIX}{PARTIAL_SUFFIX}"))
    return tuple(recover_segment(path) for path in parts if not path.with_name(path.name.removesuffix(PARTIAL_SUFFIX)).exists())


def _adopt_rewriting(folder: Path) -> None:
    """Add a segment to the log that was being rewritten when the daemon was killed; it may hold messages that the disk lost elsewhere.

    Raises:
        SemliveError: it cannot be read or renamed.
    """
    for path in sorted(folder.glob(f"*{SUFFIX}{REWRITING}")):
        finished = path.with_name(path.name.removesuffix(REWRITING))
        part = finished.with_name(finished.name + PARTIAL_SUFFIX)
        try:
            with path.open("rb") as stream:
                busy = is_being_written(stream)
            if not (busy or finished.exists() or part.exists()):
                path.rename(part)
        except OSError as exc:
            raise SemliveError(f"{path}: cannot be recovered ({exc.strerror or exc}); check the disk and try again.") from exc


def recover_segment(path: Path, out: Path | None = None, read: Callable[[int], object] = lambda _: None) -> RepairSummary:
    """Make one segment valid: all intact messages in order, with an index.

    Args:
        path: the segment, finished or ``.part``.
        out: destination of the valid segment; None for its finished name, and the damaged original is stored in the same folder.
        read: callback with the number of bytes read.

    Raises:
        BadLog: it is no MCAP file, or it is being written.
        SemliveError: it cannot be read or written.
    """
    target = out or path.with_name(path.name.removesuffix(PARTIAL_SUFFIX))
    growing = target.with_name(target.name + _GROWING)
    try:
        with open_regular(path) as stream:
            if is_being_written(stream):
                raise BadLog(f"{path}: is being written by a running semlive; stop that run first.")
            with growing.open("wb") as written:
                recovered = replace(_recover(stream, written, read), source=path, path=target)
                written.flush()
                os.fsync(written.fileno())
        return _put_in_place(recovered, growing, out is None)
    except OSError as exc:
        with contextlib.suppress(OSError):
            growing.unlink()
        raise SemliveError(f"{path}: cannot be recovered ({exc.strerror or exc}); make room on the disk and try again.") from exc
    except BadLog as exc:
        growing.unlink(missing_ok=True)
        raise BadLog(str(exc) if str(path) in str(exc) else f"{path}: {exc}") from exc


def _put_in_place(recovered: RepairSummary, growing: Path, in_place: bool) -> RepairSummary:
    path, target = recovered.source, recovered.path
    if recovered.was_intact:
        growing.unlink()
        if not in_place:
            shutil.copyfile(path, target)
        elif path != target:
            path.replace(target)
    elif not in_place:
        growing.replace(target)
    else:
        original = _free_name(path.with_name(path.name.removesuffix(PARTIAL_SUFFIX).removesuffix(SUFFIX) + ORIGINAL))
        if path == target:
            try:
                os.link(path, original)
            except OSError:
                # Without links on this file system the log has, for an instant, only its other name.
                path.replace(original)
            growing.replace(target)
        else:
            growing.replace(target)
            path.replace(original)
        recovered = replace(recovered, original=original)
    sync_folder(target.parent)
    return recovered


def _free_name(path: Path) -> Path:
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}{number}")
    return free


@dataclass(slots=True)
class _Account:
    """Account of retained and lost messages while a segment is read."""

    channels: Mapping[int, Channel]
    recovered: Counter[str] = field(default_factory=Counter)
    skipped: Counter[str] = field(default_factory=Counter)
    newest: dict[str, int] = field(default_factory=dict)
    damage: list[Damage] = field(default_factory=list)
    last_ns: int | None = None
    open_damage: bool = False

    def read(self, topic: str, message: Message) -> None:
        self.recovered[topic] += 1
        if topic in TOPICS and topic not in RAW_TOPICS:
            self.skipped[topic] += max(0, message.sequence - self.newest.get(topic, -1) - 1)
            self.newest[topic] = message.sequence
        self.last_ns = message.log_time
        if self.open_damage:
            self.open_damage = False
            self.damage = [replace(damage, before_ns=message.log_time) if damage.before_ns is None else damage for damage in self.damage]

    def damaged(self, span: SegmentSpan) -> None:
        self.damage.append(Damage(span.start, span.end, span.damage, self.last_ns, None, {}))
        self.open_damage = True

    def indexed(self, index: MessageIndex) -> None:
        """Add the losses of a damaged chunk from the index after it."""
        channel = self.channels.get(index.channel_id)
        if channel is not None and self.open_damage:
            last = self.damage[-1]
            self.damage[-1] = replace(last, lost={**last.lost, channel.topic: len(index.records)})

    def lost(self, statistics: Statistics | None) -> dict[str, int]:
        if statistics is not None:
            expected = {
                self.channels[number].topic: n for number, n in statistics.channel_message_counts.items() if number in self.channels
            }
            lost = {topic: n - self.recovered[topic] for topic, n in expected.items()}
        else:
            indexed = sum((Counter(damage.lost) for damage in self.damage), Counter[str]())
            lost = {topic: max(indexed[topic], self.skipped[topic]) for topic in indexed | self.skipped}
        return {topic: n for topic, n in sorted(lost.items()) if n > 0}


def _recover(stream: BinaryIO, out: BinaryIO, read: Callable[[int], object]) -> RepairSummary:
    """Copy the intact messages of a segment to another; the caller sets the paths."""
    channels, schemas = channels_and_schemas(stream)
    total = next((record for record in summary(stream) if isinstance(record, Statistics)), None)
    account, writer, adopted = _Account(channels), LogWriter(out), set[str]()
    unknown = 0
    for span in scan_spans(stream):
        if span.damage and not span.truncated:
            account.damaged(span)
        for record in span.records:
            if isinstance(record, MessageIndex):
                account.indexed(record)
            elif isinstance(record, Metadata) and (after_ns := rewritten_in(record)) is not None:
                writer.write_rewritten_metadata(after_ns)
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    unknown += 1
                    continue
                if channel.topic not in adopted:
                    adopted.add(channel.topic)
                    _adopt(writer, channel, schemas)
                account.read(channel.topic, record)
                writer.write(channel.topic, record.data, record.log_time, record.publish_time, record.sequence)
        if span.truncated:
            # The readable messages of a truncated chunk precede the truncation.
            account.damaged(span)
        # Chunks stay as small as they were, so that later damage affects as few messages as possible.
        writer.flush()
        read(span.end)
    writer.finish()
    damage = list(account.damage)
    complete = (total is not None or not damage) and not unknown
    if total is None and not damage:
        damage.append(Damage(0, 0, "the index at the end is damaged", account.last_ns, None, {}))
    if unknown:
        damage.append(Damage(0, 0, f"{unknown} messages belong to topics without a description in the file", None, None, {}))
    return RepairSummary(Path(), Path(), None, dict(sorted(account.recovered.items())), account.lost(total), complete, tuple(damage))


def _adopt(writer: LogWriter, channel: Channel, schemas: Mapping[int, Schema]) -> None:
    """Register a channel with the schema of the log, or with the present schema if that is lost."""
    schema = schemas.get(channel.schema_id)
    if schema is not None or channel.schema_id == 0 or channel.topic not in TOPICS:
        writer.register_channels(channel, schema)
