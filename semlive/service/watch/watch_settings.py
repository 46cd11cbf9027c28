"""Settings of the watch of an export folder, and the report about a rejected file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from semlive.data.settings import RowClockUse, ScanProfile
from semlive.service.watch.sidecars import IMAGE_SUFFIXES


@dataclass(frozen=True, slots=True)
class WatchSettings:
    """Watched folder, and criteria for a complete file.

    Attributes:
        folder: export folder of the SEM.
        poll_s: wall seconds between scans, if nothing wakes them.
        use_events: file-system events wake the scan.
        proof_after_s: wall seconds without change of a file whose bytes prove that it is complete; above the resolution of its times.
        stable_for_s: wall seconds for which size and times must be constant.
        stable_polls: number of scans for which they must be constant.
        give_up_after_s: wall seconds after which a constant but unreadable file is rejected.
        max_bytes: a larger file is rejected unread; the log needs twice as much at once.
        suffixes: endings of image files, lower case; other files are ignored.
        ignore_suffixes: endings of files that will be renamed when they are complete.
        adopt: accept files that exist when the watch begins; otherwise they do not belong to this run.
        first_export: number of the first accepted file.
        vendor: vendor whose header every complete file must have; None for any.
        row_clock: whether the row starts of the instrument's own clock are awaited for every image.
        sidecar_timeout_s: wall seconds for which a text file is awaited.
        profile: number of databar rows for files that do not contain it.
    """

    folder: Path
    poll_s: float = 1.0
    use_events: bool = True
    proof_after_s: float = 0.02
    stable_for_s: float = 2.0
    stable_polls: int = 2
    give_up_after_s: float = 30.0
    max_bytes: int = 2**28
    suffixes: tuple[str, ...] = IMAGE_SUFFIXES
    ignore_suffixes: tuple[str, ...] = (".tmp", ".temp", ".part", "~")
    adopt: bool = False
    first_export: int = 0
    vendor: str | None = None
    row_clock: RowClockUse = "if_present"
    sidecar_timeout_s: float = 60.0
    profile: ScanProfile = field(default_factory=ScanProfile)


@dataclass(frozen=True, slots=True)
class RejectedFile:
    """A rejected file, reported once.

    Attributes:
        name: file name.
        reason: one sentence.
        size: bytes.
        mtime_ns: modification time, UTC ns.
        sha256: digest of its bytes; empty if they were not read.
        time_ns: experiment time of the rejection.
    """

    name: str
    reason: str
    size: int
    mtime_ns: int
    sha256: str
    time_ns: int
