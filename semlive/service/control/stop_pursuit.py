"""A stop is repeated until the device rests: when the next one is due, by which way, and whether the machine obeys.

That a device acknowledges a stop does not mean that it stops. It rests when it reports no motion and neither its extension nor its load (in
the direction of the last ramp; a held load relaxes) changes. Until then the stop is sent again on a schedule, in turn by every way that
the device offers, and an alarm asks for the machine's own stop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.loading import LoadSample, MotionState, StageSample

_AGAIN_S = (0.1, 0.2, 0.4, 0.8, 1.0)
"""Wall seconds from one stop to the next; the last one holds from there on."""
_REST_READINGS = 3
_REST_SPAN_NS = 150_000_000
_UNKNOWN_NS = 300_000_000
DISOBEYED_S = 1.0
"""A device that still moves so long after its first stop does not obey; deceleration takes less."""
_MOVED_MM = 1e-6


@dataclass(frozen=True, slots=True)
class Motionless:
    """What counts as no motion, for a load frame.

    Attributes:
        force_n: change of the load along the last ramp that is noise.
        extension_mm: change of the extension that is noise.
        rate_n_s: rate of the last ramp; a fifth of it is motion.
        ramp_sign: direction of the last ramp; 0 if either counts.
    """

    force_n: float
    extension_mm: float
    rate_n_s: float
    ramp_sign: float


@dataclass(frozen=True, slots=True)
class StopPursuit:
    """A stop that has not been seen to have its effect.

    Attributes:
        began_mono_ns: when it was first ordered.
        next_mono_ns: when it is to be sent again.
        sent: how often it was sent.
        samples: what the device reported since the last one, oldest first.
        alarm_mono_ns: when the alarm is due.
        alarmed: what was alarmed already: that it moves (True), that nobody knows (False).
    """

    began_mono_ns: int
    next_mono_ns: int
    alarm_mono_ns: int
    sent: int = 0
    samples: tuple[LoadSample | StageSample, ...] = ()
    alarmed: frozenset[bool] = frozenset()

    def sent_again(self, now_mono_ns: int) -> StopPursuit:
        """A stop was sent now."""
        wait_s = _AGAIN_S[min(self.sent, len(_AGAIN_S) - 1)]
        return replace(self, sent=self.sent + 1, next_mono_ns=now_mono_ns + round(wait_s * 1e9))

    def alarm_due(self, now_mono_ns: int, moves: bool) -> bool:
        """Whether the operator is to be told to use the machine's own stop: once when nobody knows, once when it is seen to move."""
        return now_mono_ns >= self.alarm_mono_ns and moves not in self.alarmed and True not in self.alarmed

    def with_alarm(self, moves: bool) -> StopPursuit:
        """The alarm was raised."""
        return replace(self, alarmed=self.alarmed | {moves})

    def with_sample(self, sample: LoadSample | StageSample) -> StopPursuit:
        """One reading more; the latest second is kept, and at least the readings that show rest: some links give one in a second."""
        recent = tuple(one for one in self.samples if one.mono_ns > sample.mono_ns - 1_000_000_000)
        fewest = self.samples[-(_REST_READINGS - 1) :]
        return replace(self, samples=(*(recent if len(recent) > len(fewest) else fewest), sample))

    def moves(self, still: Motionless | None) -> bool:
        """Whether the latest readings show motion; `still` is None for a stage, whose report of motion is believed."""
        if not self.samples:
            return False
        first, last = self.samples[0], self.samples[-1]
        if last.motion is MotionState.MOVING:
            return True
        if still is None or not isinstance(first, LoadSample) or not isinstance(last, LoadSample):
            return False
        apart_s = (last.time_ns - first.time_ns) / 1e9
        change_n = last.force_n - first.force_n
        along_n = change_n * still.ramp_sign if still.ramp_sign else abs(change_n)
        travel_mm = abs(last.extension_mm - first.extension_mm)
        return along_n > max(still.force_n, 0.2 * still.rate_n_s * apart_s) or travel_mm > max(2.0 * still.extension_mm, _MOVED_MM)

    def rests(self, still: Motionless | None) -> bool:
        """Whether the latest readings, three at least, show rest."""
        for first in range(len(self.samples) - _REST_READINGS, -1, -1):
            latest = self.samples[first:]
            if latest[-1].mono_ns - latest[0].mono_ns >= _REST_SPAN_NS:
                return not any(one.motion is MotionState.MOVING for one in latest) and not replace(self, samples=latest).moves(still)
        return False

    def due(self, now_mono_ns: int, still: Motionless | None) -> bool:
        """Whether the stop is to be sent again: at once while motion is seen, after a while without any reading."""
        if now_mono_ns < self.next_mono_ns:
            return False
        return self.sent == 0 or self.moves(still) or now_mono_ns - self._known_mono_ns > _UNKNOWN_NS

    @property
    def _known_mono_ns(self) -> int:
        return max(self.began_mono_ns, self.samples[-1].mono_ns if self.samples else 0)


def begin_pursuit(now_mono_ns: int) -> StopPursuit:
    """A stop is to be sent now."""
    return StopPursuit(now_mono_ns, now_mono_ns, now_mono_ns + round(DISOBEYED_S * 1e9))
