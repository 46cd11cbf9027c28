"""Repetition of a stop until the device is at rest: schedule of the stop commands, detection of rest, and alarm.

An acknowledged stop does not prove that the device stops. The device is at rest when it reports no motion and neither its extension nor its
load changes (the load in the direction of the last ramp, because a held load relaxes). Until then the stop is repeated on a schedule, with
all stop methods of the device in turn, and an alarm requests the emergency stop of the machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.loading import LoadSample, MotionState, StageSample

_RESEND_S = (0.1, 0.2, 0.4, 0.8, 1.0)
"""Intervals between stop commands, wall seconds; the last one is repeated."""
_REST_READINGS = 3
_REST_SPAN_NS = 150_000_000
_NO_READING_NS = 300_000_000
DISOBEYED_S = 1.0
"""Time after the first stop from which motion is reported as a disobeyed stop, s; deceleration takes less."""
_MOVED_MM = 1e-6


@dataclass(frozen=True, slots=True)
class Motionless:
    """Thresholds of no motion for a load frame.

    Attributes:
        force_n: change of the load along the last ramp that is noise.
        extension_mm: change of the extension that is noise.
        rate_n_s: rate of the last ramp; a fifth of it counts as motion.
        ramp_sign: direction of the last ramp, +1 or -1; 0 if both directions count.
    """

    force_n: float
    extension_mm: float
    rate_n_s: float
    ramp_sign: float


@dataclass(frozen=True, slots=True)
class StopPursuit:
    """A stop whose effect the readings have not confirmed.

    Attributes:
        began_mono_ns: time of the first stop command.
        next_mono_ns: time of the next stop command.
        alarm_mono_ns: time from which the alarm is due.
        sent: number of stop commands sent.
        samples: latest samples of the device, oldest first.
        alarmed: alarms already raised: motion (True), unknown motion (False).
    """

    began_mono_ns: int
    next_mono_ns: int
    alarm_mono_ns: int
    sent: int = 0
    samples: tuple[LoadSample | StageSample, ...] = ()
    alarmed: frozenset[bool] = frozenset()

    def sent_again(self, now_mono_ns: int) -> StopPursuit:
        """Return the pursuit after a stop command was sent."""
        wait_s = _RESEND_S[min(self.sent, len(_RESEND_S) - 1)]
        return replace(self, sent=self.sent + 1, next_mono_ns=now_mono_ns + round(wait_s * 1e9))

    def alarm_due(self, now_mono_ns: int, moves: bool) -> bool:
        """Whether the alarm for the emergency stop is due: once for unknown motion, and once for observed motion."""
        return now_mono_ns >= self.alarm_mono_ns and moves not in self.alarmed and True not in self.alarmed

    def with_alarm(self, moves: bool) -> StopPursuit:
        """Return the pursuit after the alarm was raised."""
        return replace(self, alarmed=self.alarmed | {moves})

    def with_sample(self, sample: LoadSample | StageSample) -> StopPursuit:
        """Add a sample; retain the samples of the latest second, and at least as many as show rest, for slow links."""
        recent = tuple(reading for reading in self.samples if reading.mono_ns > sample.mono_ns - 1_000_000_000)
        minimum = self.samples[-(_REST_READINGS - 1) :]
        return replace(self, samples=(*(recent if len(recent) > len(minimum) else minimum), sample))

    def moves(self, still: Motionless | None) -> bool:
        """Whether the latest readings show motion; `still` is None if only the motion report of the device is used."""
        if not self.samples:
            return False
        first, last = self.samples[0], self.samples[-1]
        if last.motion is MotionState.MOVING:
            return True
        if still is None or not isinstance(first, LoadSample) or not isinstance(last, LoadSample):
            return False
        interval_s = (last.time_ns - first.time_ns) / 1e9
        change_n = last.force_n - first.force_n
        along_n = change_n * still.ramp_sign if still.ramp_sign else abs(change_n)
        travel_mm = abs(last.extension_mm - first.extension_mm)
        return along_n > max(still.force_n, 0.2 * still.rate_n_s * interval_s) or travel_mm > max(2.0 * still.extension_mm, _MOVED_MM)

    def rests(self, still: Motionless | None) -> bool:
        """Whether the latest readings, at least three, show rest."""
        for first in range(len(self.samples) - _REST_READINGS, -1, -1):
            latest = self.samples[first:]
            if latest[-1].mono_ns - latest[0].mono_ns >= _REST_SPAN_NS:
                return not any(sample.motion is MotionState.MOVING for sample in latest) and not replace(self, samples=latest).moves(still)
        return False

    def due(self, now_mono_ns: int, still: Motionless | None) -> bool:
        """Whether the next stop command is due: on schedule while the readings show motion, or after some time without a reading."""
        if now_mono_ns < self.next_mono_ns:
            return False
        return self.sent == 0 or self.moves(still) or now_mono_ns - self._latest_mono_ns > _NO_READING_NS

    @property
    def _latest_mono_ns(self) -> int:
        return max(self.began_mono_ns, self.samples[-1].mono_ns if self.samples else 0)


def begin_pursuit(now_mono_ns: int) -> StopPursuit:
    """Return the pursuit of a stop that begins now."""
    return StopPursuit(now_mono_ns, now_mono_ns, now_mono_ns + round(DISOBEYED_S * 1e9))
