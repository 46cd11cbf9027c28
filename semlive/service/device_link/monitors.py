"""Pure supervision of a link: silence of control, and age, limits and continuity of the readings.

Theory of operation
-------------------
Both monitors are frozen values. The link thread replaces them after each reading and each cycle and acts on what they return; they read no
clock and call no device. Control reads the age of the newest sample from the monitor of the link thread, which is replaced in one step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, MotionState, StageSample
from semlive.engine.supervision.ramp_readings import Finding


@dataclass(frozen=True, slots=True)
class DeadManSwitch:
    """Detects that control no longer sends keep-alive signals.

    Attributes:
        timeout_ns: longest time between two signals, ns.
        control_silent: the time since the last signal exceeds the timeout.
    """

    timeout_ns: int
    control_silent: bool = False

    def checked(self, silent_ns: int) -> DeadManSwitch:
        """Return the switch after a check; `silent_ns` is the time since the last signal, ns."""
        return replace(self, control_silent=silent_ns > self.timeout_ns)


@dataclass(frozen=True, slots=True)
class SampleMonitor:
    """State of the readings of a device.

    Attributes:
        sampled_mono_ns: monotonic time of the newest sample; None before the first.
        beyond_limit: the newest sample violated a limit, so the device was already stopped for it.
        stale: the newest sample is older than `limits.stale_after_s`, which was reported.
        lost: the newest sample is older than `limits.lost_after_s`, which was reported.
        reading_count: counter of readings in the device at the newest sample; None without such a counter.
    """

    sampled_mono_ns: int | None = None
    beyond_limit: bool = False
    stale: bool = False
    lost: bool = False
    reading_count: int | None = None

    def finding(self, sample: LoadSample | StageSample, problem: Finding | None) -> Finding | None:
        """Return why the device must stop now: a new problem of the reading, or motion before the first order; else None."""
        if problem is not None and not self.beyond_limit:
            return problem
        if self.sampled_mono_ns is None and sample.motion is MotionState.MOVING:
            return Finding(FaultCode.UNORDERED_MOTION, "it moved before a motion was ordered")
        return None

    def with_sample(self, sample: LoadSample | StageSample, problem: Finding | None) -> SampleMonitor:
        """Return the state after a sample; `problem` is the problem of this reading."""
        counted = sample.counted if isinstance(sample, LoadSample) else None
        count = self.reading_count if counted is None else counted[0]
        return SampleMonitor(sample.mono_ns, problem is not None, reading_count=count)

    def restart(self, sample: LoadSample | StageSample) -> str | None:
        """Return the fault text if the counter of readings shows a restart, after which orders and perhaps the zero are lost."""
        if not isinstance(sample, LoadSample) or sample.counted is None or self.reading_count is None:
            return None
        (count, modulus), previous = sample.counted, self.reading_count
        if (count - previous) % modulus <= modulus // 2:
            return None
        return f"it was restarted: its counter of readings went from {previous} to {count}; check its zero, position and settings"

    def age_s(self, now_mono_ns: int) -> float:
        """Wall time since the newest sample, s; infinite before the first."""
        return math.inf if self.sampled_mono_ns is None else (now_mono_ns - self.sampled_mono_ns) / 1e9

    def becomes_stale(self, age_s: float, limits: Limits) -> bool:
        """Whether the newest sample is stale, and this was not reported."""
        return age_s > limits.stale_after_s and not self.stale and self.sampled_mono_ns is not None

    def becomes_lost(self, age_s: float, limits: Limits) -> bool:
        """Whether the newest sample is so old that the link is lost, and this was not reported."""
        return age_s > limits.lost_after_s and not self.lost and self.sampled_mono_ns is not None
