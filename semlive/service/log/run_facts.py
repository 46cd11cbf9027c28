"""Facts about a run in its log besides measurements: alarms, refused frames, versions, configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from semlive.formats.log.messages import FileMessage, RunMessage, from_json
from semlive.service.log.alarms import TOPICS as ALARM_TOPICS
from semlive.service.log.alarms import Alarms, after
from semlive.service.log.files import messages


@dataclass(frozen=True, slots=True)
class RefusedFile:
    """An exported file that was not used.

    Attributes:
        export: its number; None if it was refused before it got a number.
        name: file name; empty if the log does not contain it.
        reason: one sentence.
    """

    export: int | None
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class LogFacts:
    """Facts about a run.

    Attributes:
        host: name of the computer.
        segments: number of starts and resumptions of the run.
        versions: versions of the programs, by name.
        config: the checked configuration.
        files: number of exported files that arrived.
        refused: files that were not used, in order.
        alarms: alarms of the run; None if the log was not searched for them.
        sha256: checksums of the exported files, hexadecimal, by their number.
    """

    host: str = ""
    segments: int = 0
    versions: dict[str, str] | None = None
    config: dict[str, Any] | None = None
    files: int = 0
    refused: tuple[RefusedFile, ...] = ()
    alarms: Alarms | None = None
    sha256: Mapping[int, str] = field(default_factory=dict[int, str])


def log_facts(log: Path) -> LogFacts:
    """Read the facts about a run from its log.

    Raises:
        BadLog: the log cannot be read.
    """
    runs: list[RunMessage] = []
    names: dict[int, str] = {}
    sha256: dict[int, str] = {}
    refused: list[RefusedFile] = []
    alarms = Alarms()
    for message in messages(log):
        if message.topic not in ("/run", "/sem/file", *ALARM_TOPICS):
            continue
        content = from_json(message.topic, message.payload)
        alarms = after(alarms, content)
        if isinstance(content, RunMessage):
            runs.append(content)
        elif isinstance(content, FileMessage):
            if content.decision == "arrived" and content.export is not None:
                names[content.export] = content.name
                sha256[content.export] = content.sha256
            elif content.decision == "refused":
                name = content.name or ("" if content.export is None else names.get(content.export, ""))
                refused.append(RefusedFile(content.export, name, content.reason))
    if not runs:
        return LogFacts(files=len(names), refused=tuple(refused), alarms=alarms, sha256=sha256)
    first = runs[0]
    return LogFacts(first.host, len(runs), dict(first.versions), dict(first.config), len(names), tuple(refused), alarms, sha256)
