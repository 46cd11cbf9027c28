"""Clock offsets of the SEM computer and of the network share: a fold over the exported files, so that a replay gives equal results."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from semlive.data.clock import ClockOffset
from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.settings import ScanProfile
from semlive.formats.log.messages import ClockOffsetMessage
from semlive.formats.metadata.timestamps import ONE_SECOND_SIGMA_S

_EXPORT_SIGMA_S = 2.0  # assumed time from the end of a scan to the last byte of its file
_WRONG_S = 8.0
_WRONG_SIGMAS = 3.0
_PROBE = ".semlive-clock"


@dataclass(frozen=True, slots=True)
class FileClockOffsets:
    """Offsets of both clocks so far.

    Attributes:
        sem: clock of the SEM computer, from the raw times in the files, read as UTC.
        share: clock of the share, from the modification times of the files.
    """

    sem: ClockOffset
    share: ClockOffset

    @classmethod
    def with_poll_interval(cls, poll_s: float) -> FileClockOffsets:
        """Return the initial state for a polling interval."""
        return cls(ClockOffset("sem", math.hypot(ONE_SECOND_SIGMA_S, _EXPORT_SIGMA_S), poll_s), ClockOffset("share", 0.0, poll_s))

    def updated(self, file: ExportedFile, info: FrameInfo, profile: ScanProfile) -> tuple[FileClockOffsets, tuple[ClockOffsetMessage, ...]]:
        """Add a file; return the new state and the messages about both clocks."""
        if not file.stable_time_ns:
            return self, ()
        messages: list[ClockOffsetMessage] = []
        share, reason = self.share.updated(file.mtime_ns, file.stable_time_ns)
        if reason is not None:
            messages.append(_message(share, file.index, reason))
        sem = self.sem
        if info.embedded_time_ns is not None:
            later_ns = round(info.timing.duration_s * 1e9) if info.start_anchor == "start" else 0
            # The corrected modification time is closer to the end of writing than the time of the scan that found the file.
            written_ns = file.mtime_ns - round(share.offset_s * 1e9)
            sem, reason = sem.updated(info.embedded_time_ns + later_ns, min(written_ns, file.stable_time_ns))
            if reason is not None:
                messages.append(_message(sem, file.index, reason, _advice(sem, profile)))
        return FileClockOffsets(sem, share), tuple(messages)


def _message(clock: ClockOffset, export: int, reason: str, advice: str = "") -> ClockOffsetMessage:
    return ClockOffsetMessage(
        clock=clock.clock,
        offset_s=clock.offset_s,
        sigma_s=clock.sigma_s,
        files=clock.sample_count,
        export=export,
        reason=reason,
        advice=advice,
    )


def _advice(sem: ClockOffset, profile: ScanProfile) -> str:
    """Return advice about a clock whose error exceeds the export time."""
    wrong_s = sem.offset_s - profile.clock_offset_s
    if abs(wrong_s) <= max(_WRONG_S, _WRONG_SIGMAS * sem.sigma_s):
        return ""
    return (
        f"the SEM's clock differs by {sem.offset_s:+.0f} s from this computer's, and sem.profile.clock_offset_s is "
        f"{profile.clock_offset_s:g}; set one of the clocks, or sem.profile.clock_offset_s: {sem.offset_s:.0f}."
    )


def probe_share(folder: Path, utc_ns: Callable[[], int]) -> ClockOffsetMessage | None:
    """Measure the clock of a share by writing a small file, accurate to the duration of the write; None if it is not writable."""
    path = folder / _PROBE
    try:
        before_ns = utc_ns()
        path.write_bytes(b"semlive asks for the time")
        after_ns = utc_ns()
        modified_ns = path.stat().st_mtime_ns
        os.unlink(path)
    except OSError:
        return None
    offset_s = (modified_ns - (before_ns + after_ns) / 2) / 1e9
    return ClockOffsetMessage(
        clock="share",
        offset_s=offset_s,
        sigma_s=max((after_ns - before_ns) / 1e9, 1e-3),
        files=0,
        export=None,
        reason="a file was written to it",
    )
