"""Experiment time, equal in every process of a run, and the offsets of other computers' clocks from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

_MAX_DIFFERENCES = 50
_MIN_STEP_S = 30.0
_MIN_FILES_AHEAD, _MIN_FILES_BEHIND = 2, 6
_MIN_FILES = 3
_MIN_CHANGE_SIGMAS = 3.0
_MIN_CHANGE_S = 0.5


@dataclass(frozen=True, slots=True)
class Clock:
    """Experiment time as a straight line over the machine-wide monotonic clock.

    At an instrument the rate is 1 and experiment time is UTC; in a simulation the rate may be larger.
    A simulator that falls behind publishes a new line that is set back ("stretched"); `revision` counts them. Time itself never goes
    back: it is constant in every process, for the simulated devices and for the stamps of their readings, until the line has caught up.

    Attributes:
        utc0_ns: experiment time at `mono0_ns`, UTC ns since 1970.
        mono0_ns: reading of ``time.monotonic_ns()`` at that instant.
        rate: seconds of experiment time per second of wall time, > 0.
        revision: 0 for the first clock of a run, one more for each stretch.
        not_before_ns: experiment time at the last stretch, UTC ns, at which time is constant until the line reaches it; 0 if none.
    """

    utc0_ns: int
    mono0_ns: int
    rate: float = 1.0
    revision: int = 0
    not_before_ns: int = 0

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(f"clock rate must be > 0, not {self.rate}")

    def time_ns(self, mono_ns: int) -> int:
        """The line: experiment time (UTC ns) at a reading of the monotonic clock, not constant after a stretch."""
        return self.utc0_ns + round((mono_ns - self.mono0_ns) * self.rate)

    def now_ns(self, mono_ns: int) -> int:
        """Experiment time (UTC ns) at a reading of the monotonic clock; constant after a stretch until the line has caught up."""
        return max(self.not_before_ns, self.time_ns(mono_ns))

    def mono_ns(self, time_ns: int) -> int:
        """Reading of the monotonic clock at an experiment time (UTC ns)."""
        return self.mono0_ns + round((time_ns - self.utc0_ns) / self.rate)

    def stretched(self, by_ns: int, mono_ns: int) -> Clock:
        """The clock set back by `by_ns` of experiment time at a reading of the monotonic clock.

        An event planned for t occurs later by that amount. Until the line has caught up, time is constant.
        """
        return Clock(self.utc0_ns - by_ns, self.mono0_ns, self.rate, self.revision + 1, self.now_ns(mono_ns))


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Offset of one computer's clock from experiment time.

    Each file gives a lower bound: the time stamp of the file minus the time at which the watcher first saw the complete file. The stamped
    event occurred earlier by the duration of export and polling, so the largest difference is the best estimate of the offset.

    Attributes:
        clock: ``sem`` or ``share``.
        resolution_sigma_s: standard uncertainty by the resolution of the time stamps, s.
        poll_interval_s: interval at which the watcher polls the folder, experiment s.
        differences_s: clock minus experiment time of the newest files since the last step of the clock.
        sample_count: number of files since then.
        outliers_s: differences of the newest files that disagree, oldest first.
        reported_offset_s: offset in the last report; None before the first report.
    """

    clock: str
    resolution_sigma_s: float
    poll_interval_s: float
    differences_s: tuple[float, ...] = ()
    sample_count: int = 0
    outliers_s: tuple[float, ...] = ()
    reported_offset_s: float | None = None

    @property
    def offset_s(self) -> float:
        """The clock minus experiment time."""
        return max(self.differences_s)

    @property
    def sigma_s(self) -> float:
        """Standard uncertainty by time stamp resolution, polling interval and the scatter of export durations."""
        ordered = sorted(self.differences_s, reverse=True)
        delay_s = self.poll_interval_s if len(ordered) < _MIN_FILES else max(ordered[0] - ordered[len(ordered) // 2], 1e-3)
        return math.hypot(self.resolution_sigma_s, delay_s)

    def updated(self, clock_ns: int, settled_ns: int, printed_sigma_s: float | None = None) -> tuple[ClockOffset, str | None]:
        """Offset with one more file.

        Args:
            clock_ns: time stamp of the file, UTC ns.
            settled_ns: experiment time at which the watcher first saw the complete file, UTC ns.
            printed_sigma_s: standard uncertainty by the resolution of this time stamp; None: as before.

        Returns:
            The updated offset and the reason to report it; the reason is None if nothing changed.
        """
        difference_s = (clock_ns - settled_ns) / 1e9
        printed = self.resolution_sigma_s if printed_sigma_s is None else printed_sigma_s
        current = replace(self, resolution_sigma_s=printed)
        if not self.differences_s:
            return _restarted(current, (difference_s,)), "first file with this clock"
        stepped_s = difference_s - self._usual_s
        if abs(stepped_s) > _MIN_STEP_S:
            # A file copied with delay looks like a clock that was set back; no file is ahead of its clock.
            enough = _MIN_FILES_AHEAD if stepped_s > 0 else _MIN_FILES_BEHIND
            outliers_s = (*self.outliers_s, difference_s)[-enough:]
            if len(outliers_s) == enough and max(outliers_s) - min(outliers_s) < _MIN_STEP_S:
                return _restarted(current, outliers_s), f"the clock was set by {stepped_s:+.1f} s"
            return replace(current, outliers_s=outliers_s), None
        refined = replace(
            current,
            differences_s=(*self.differences_s, difference_s)[-_MAX_DIFFERENCES:],
            sample_count=self.sample_count + 1,
            outliers_s=(),
        )
        moved_s = abs(refined.offset_s - (self.reported_offset_s or 0.0))
        if refined.sample_count != _MIN_FILES and moved_s < max(_MIN_CHANGE_SIGMAS * refined.sigma_s, _MIN_CHANGE_S):
            return refined, None
        return replace(refined, reported_offset_s=refined.offset_s), "more files determine the offset better"

    @property
    def _usual_s(self) -> float:
        ordered = sorted(self.differences_s)
        return ordered[len(ordered) // 2]


def _restarted(offset: ClockOffset, differences_s: tuple[float, ...]) -> ClockOffset:
    return replace(
        offset, differences_s=differences_s, sample_count=len(differences_s), outliers_s=(), reported_offset_s=max(differences_s)
    )
