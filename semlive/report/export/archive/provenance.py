"""Provenance of exported fields: files of the log, exported images, versions of the programs, instrument."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from semlive.data.frame import ExportedFile
from semlive.data.settings import ScanProfile
from semlive.formats.images.inspection import inspect_file
from semlive.formats.log.messages import SEM_ORIGINAL, SEM_SIDECAR, FileMessage, RunMessage, from_json
from semlive.formats.log.reader import LogMessage
from semlive.report.export.archive.deposit import Deposit
from semlive.service.log.files import messages, segments

_BLOCK_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class HashedFile:
    """A file and its identity.

    Attributes:
        path: where it is; None for a file inside the log.
        name: its name.
        size: bytes.
        sha256: hexadecimal.
    """

    path: Path | None
    name: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class ExportProvenance:
    """Provenance of an export.

    Attributes:
        deposit: description by the user.
        log: files of the log, in order.
        images: exported images by number.
        versions: versions of the programs that recorded the run, by name.
        semlive: version of semlive that exports.
        instrument: name of the instrument in the first image; None if unknown.
    """

    deposit: Deposit
    log: tuple[HashedFile, ...]
    images: Mapping[int, HashedFile]
    versions: Mapping[str, str]
    semlive: str
    instrument: str | None


def export_provenance(log: Path, deposit: Deposit, profile: ScanProfile) -> ExportProvenance:
    """Collect the provenance of an export; the log is read twice, for its messages and for the checksums of its files.

    Args:
        log: one file, or a run folder.
        deposit: description by the user.
        profile: configured values for metadata that images lack.

    Raises:
        BadLog: the log cannot be read.
    """
    images: dict[int, HashedFile] = {}
    versions: dict[str, str] = {}
    announced: FileMessage | None = None
    sidecar: bytes | None = None
    instrument: str | None = None
    for message in messages(log):
        if message.topic == "/run" and not versions:
            run = from_json(message.topic, message.payload)
            versions = dict(run.versions) if isinstance(run, RunMessage) else {}
        elif message.topic == "/sem/file":
            file = from_json(message.topic, message.payload)
            if isinstance(file, FileMessage) and file.decision == "arrived" and file.export is not None:
                images[file.export] = HashedFile(None, file.name, file.size, file.sha256)
                announced, sidecar = file, None
        elif message.topic == SEM_SIDECAR:
            sidecar = message.payload
        elif message.topic == SEM_ORIGINAL and instrument is None and announced is not None:
            instrument = _instrument(message, announced, sidecar, profile)
    return ExportProvenance(
        deposit, tuple(hashed(path) for path in segments(log)), images, versions, version("semlive"), instrument or None
    )


def hashed(path: Path) -> HashedFile:
    """Return a file with its size and checksum."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            digest.update(block)
    return HashedFile(path, path.name, path.stat().st_size, digest.hexdigest())


def _instrument(message: LogMessage, file: FileMessage, sidecar: bytes | None, profile: ScanProfile) -> str:
    """Return the name of the instrument in an image; empty if it has none."""
    exported = ExportedFile(
        message.sequence, file.name, message.payload, file.sha256, file.mtime_ns, file.arrival_time_ns, sidecar, file.settled_time_ns
    )
    value = inspect_file(exported, profile).values.get("instrument")
    return value.value if value is not None and isinstance(value.value, str) else ""
