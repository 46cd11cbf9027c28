"""Experiment time, the same in every process of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class Clock:
    """Experiment time as a straight line over the machine-wide monotonic clock.

    At an instrument the rate is 1 and experiment time is UTC; in a simulation the rate may be larger.
    A simulator that falls behind publishes a new line with a later ``mono0_ns`` ("stretched"); `revision` counts them.

    Attributes:
        utc0_ns: experiment time at `mono0_ns`, UTC ns since 1970.
        mono0_ns: reading of ``time.monotonic_ns()`` at that instant.
        rate: seconds of experiment time per second of wall time, > 0.
        revision: 0 for the first clock of a run, one more for each stretch.
    """

    utc0_ns: int
    mono0_ns: int
    rate: float = 1.0
    revision: int = 0

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(f"clock rate must be > 0, not {self.rate}")

    def time_ns(self, mono_ns: int) -> int:
        """Experiment time (UTC ns) at a reading of the monotonic clock."""
        return self.utc0_ns + round((mono_ns - self.mono0_ns) * self.rate)

    def mono_ns(self, time_ns: int) -> int:
        """Reading of the monotonic clock at an experiment time (UTC ns)."""
        return self.mono0_ns + round((time_ns - self.utc0_ns) / self.rate)

    def stretched(self, by_ns: int) -> Clock:
        """The same line set back by `by_ns` of experiment time: what was to happen at t happens that much later."""
        return Clock(self.utc0_ns - by_ns, self.mono0_ns, self.rate, self.revision + 1)


_KEPT = 50
_STEP_S = 30.0
_AHEAD_FILES, _BACK_FILES = 2, 6
_FEW = 3
_TELL_AGAIN_SIGMAS = 3.0
_TELL_AGAIN_S = 0.5


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """One clock beside experiment time.

    Each file bounds it: what its clock says of an event that was over when the watcher saw the file as it stayed. The event came
    earlier by the time that exporting and looking take, so the largest difference is nearest the truth, and always below it.

    Attributes:
        clock: ``sem`` or ``share``.
        resolution_sigma_s: of the clock's own printing.
        poll_interval_s: how far apart the watcher's looks are, experiment s.
        differences_s: clock minus experiment time of the newest files, since the clock last stepped.
        sample_count: how many files there were since then.
        outliers_s: differences of the newest files that do not fit, oldest first.
        reported_offset_s: the offset that was reported last; None before.
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
        """Standard uncertainty: of the printing, of one look, and of how unequally long exports took."""
        ordered = sorted(self.differences_s, reverse=True)
        delay_s = self.poll_interval_s if len(ordered) < _FEW else max(ordered[0] - ordered[len(ordered) // 2], 1e-3)
        return math.hypot(self.resolution_sigma_s, delay_s)

    def updated(self, clock_ns: int, settled_ns: int, printed_sigma_s: float | None = None) -> tuple[ClockOffset, str | None]:
        """With one more file: what the clock said, UTC ns, and when the watcher saw the file as it stayed.

        Returns:
            The offset after it, and why to tell it: None if nothing changed.
        """
        difference_s = (clock_ns - settled_ns) / 1e9
        printed = self.resolution_sigma_s if printed_sigma_s is None else printed_sigma_s
        known = replace(self, resolution_sigma_s=printed)
        if not self.differences_s:
            return _begun(known, (difference_s,)), "the first file tells it"
        stepped_s = difference_s - self._usual_s
        if abs(stepped_s) > _STEP_S:
            # Files that lay somewhere for a while look like a clock that was set back; ahead of its clock no file can be.
            enough = _AHEAD_FILES if stepped_s > 0 else _BACK_FILES
            astray = (*self.outliers_s, difference_s)[-enough:]
            if len(astray) == enough and max(astray) - min(astray) < _STEP_S:
                return _begun(known, astray), f"it was set by {stepped_s:+.1f} s"
            return replace(known, outliers_s=astray), None
        refined = replace(
            known, differences_s=(*self.differences_s, difference_s)[-_KEPT:], sample_count=self.sample_count + 1, outliers_s=()
        )
        moved_s = abs(refined.offset_s - (self.reported_offset_s or 0.0))
        if refined.sample_count != _FEW and moved_s < max(_TELL_AGAIN_SIGMAS * refined.sigma_s, _TELL_AGAIN_S):
            return refined, None
        return replace(refined, reported_offset_s=refined.offset_s), "more files tell it better"

    @property
    def _usual_s(self) -> float:
        ordered = sorted(self.differences_s)
        return ordered[len(ordered) // 2]


def _begun(offset: ClockOffset, differences_s: tuple[float, ...]) -> ClockOffset:
    return replace(
        offset, differences_s=differences_s, sample_count=len(differences_s), outliers_s=(), reported_offset_s=max(differences_s)
    )
