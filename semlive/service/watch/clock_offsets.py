"""The clocks of the SEM's computer and of the share, file by file: a fold over exported files, so that replay tells the same."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from semlive.data.clock_offset import ClockOffset
from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.settings import ScanProfile
from semlive.formats.log.messages import ClockOffsetMessage
from semlive.formats.metadata.timestamps import ONE_SECOND_SIGMA_S

_EXPORT_SIGMA_S = 2.0  # from the end of a scan to the last byte of its file, as far as nobody says
_WRONG_S = 8.0
_WRONG_SIGMAS = 3.0
_PROBE = ".semlive-clock"


@dataclass(frozen=True, slots=True)
class FileClockOffsets:
    """Both clocks so far.

    Attributes:
        sem: times inside the files, raw, as if the SEM's computer ran on UTC.
        share: their modification times.
    """

    sem: ClockOffset
    share: ClockOffset

    @classmethod
    def with_poll_interval(cls, poll_s: float) -> FileClockOffsets:
        """Nothing known yet, with a watcher that looks so often."""
        return cls(ClockOffset("sem", math.hypot(ONE_SECOND_SIGMA_S, _EXPORT_SIGMA_S), poll_s), ClockOffset("share", 0.0, poll_s))

    def updated(self, file: ExportedFile, info: FrameInfo, profile: ScanProfile) -> tuple[FileClockOffsets, tuple[ClockOffsetMessage, ...]]:
        """With one more file, and what is to be told of either clock."""
        if not file.stable_time_ns:
            return self, ()
        told: list[ClockOffsetMessage] = []
        share, why = self.share.updated(file.mtime_ns, file.stable_time_ns)
        if why is not None:
            told.append(_message(share, file.index, why))
        sem = self.sem
        if info.embedded_time_ns is not None:
            later_ns = round(info.timing.duration_s * 1e9) if info.start_anchor == "start" else 0
            # The share's own word, set right, is nearer to when the file was written than the watcher's look.
            written_ns = file.mtime_ns - round(share.offset_s * 1e9)
            sem, why = sem.updated(info.embedded_time_ns + later_ns, min(written_ns, file.stable_time_ns))
            if why is not None:
                told.append(_message(sem, file.index, why, _advice(sem, profile)))
        return FileClockOffsets(sem, share), tuple(told)


def _message(clock: ClockOffset, export: int, why: str, advice: str = "") -> ClockOffsetMessage:
    return ClockOffsetMessage(
        clock=clock.clock,
        offset_s=clock.offset_s,
        sigma_s=clock.sigma_s,
        files=clock.sample_count,
        export=export,
        reason=why,
        advice=advice,
    )


def _advice(sem: ClockOffset, profile: ScanProfile) -> str:
    """What to do about a clock that is wrong by more than exporting takes."""
    wrong_s = sem.offset_s - profile.clock_offset_s
    if abs(wrong_s) <= max(_WRONG_S, _WRONG_SIGMAS * sem.sigma_s):
        return ""
    return (
        f"the SEM's clock is {sem.offset_s:+.0f} s beside this computer's and sem.profile.clock_offset_s is "
        f"{profile.clock_offset_s:g}; set one of the clocks, or sem.profile.clock_offset_s: {sem.offset_s:.0f}."
    )


def probe_share(folder: Path, utc_ns: Callable[[], int]) -> ClockOffsetMessage | None:
    """Ask a share for its time by writing a small file: exact to the time that writing takes. None if nothing may be written there."""
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
