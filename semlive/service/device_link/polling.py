"""Readings of a device: polling, supervision of each sample, and the age of the newest one.

Theory of operation
-------------------
The link thread calls `poll_if_due` and `check_age` once per cycle; a reading blocks for at most the timeout of the driver. A reading that
violates a limit, or a finding of the supervision, first stops the device and is then reported. A problem is reported once, until a reading
is without it or a new order begins.
"""

from __future__ import annotations

import time
from dataclasses import replace

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, MotionState, StageSample
from semlive.engine.events import DeviceFault, DeviceStopped, LinkLost, LinkRestored, LinkStale
from semlive.engine.supervision.ramp_readings import Finding
from semlive.ports import ClockSource
from semlive.service.device_link.monitors import SampleMonitor
from semlive.service.device_link.stopping import StoppableDevice


class SamplePolling:
    """Schedule and supervision of the readings.

    Args:
        device: the device.
        clock: experiment time and the monotonic clock.
        limits: soft limits; also the ages at which a sample is stale or the link lost.
        poll_s: wall time between readings, s.
    """

    def __init__(self, device: StoppableDevice, clock: ClockSource, limits: Limits, poll_s: float) -> None:
        self._device, self._clock, self._limits = device, clock, limits
        self._poll_ns = round(poll_s * 1e9)
        self._monitor = SampleMonitor()
        self.next_mono_ns = 0
        """Time of the next reading."""

    @property
    def age_s(self) -> float:
        """Wall time since the last sample, s; infinite before the first."""
        return self._monitor.age_s(self._clock.mono_ns())

    def order_begins(self) -> None:
        """A motion is ordered: the device may move, and a problem that continues is reported again."""
        self._device.may_move = True
        self._monitor = replace(self._monitor, beyond_limit=False)

    def poll_if_due(self) -> None:
        """Read the device if the interval since the last reading is over."""
        if self._clock.mono_ns() >= self.next_mono_ns:
            self.next_mono_ns = self._clock.mono_ns() + self._poll_ns
            self._device.attempt("reading", self._poll)

    def check_age(self) -> None:
        """Report a stale sample and a lost link, each once until the next sample."""
        age_s, device = self.age_s, self._device
        if self._monitor.becomes_stale(age_s, self._limits):
            self._monitor = replace(self._monitor, stale=True)
            device.emit(LinkStale(self._clock.now_ns(), device.kind))
        if self._monitor.becomes_lost(age_s, self._limits):
            self._monitor = replace(self._monitor, lost=True)
            device.may_move = True
            reason = device.failure or f"no reading for {age_s:.1f} s"
            device.emit(LinkLost(self._clock.now_ns(), device.kind, reason))

    def _poll(self) -> None:
        device, port = self._device, self._device.connection.port
        if port is None:
            return
        request_ns = time.monotonic_ns()
        sample = port.read()
        sample = replace(sample, rtt_s=(time.monotonic_ns() - request_ns) / 1e9)
        problem, before = port.problem(sample), self._monitor
        finding = before.finding(sample, problem)
        if finding is not None:
            device.stop()
        else:
            device.observe(sample)
        device.connection.answered()
        self._monitor = before.with_sample(sample, problem)
        device.may_move = sample.motion is MotionState.MOVING or device.pursued
        if before.lost:
            device.emit(LinkRestored(sample.time_ns, device.kind))
        device.emit(port.event(sample))
        if finding is not None:
            self._emit_stop(sample, finding)
        restart = before.restart(sample)
        if restart is not None:
            device.emit(DeviceFault(sample.time_ns, device.kind, restart, code=FaultCode.DEVICE_RESTARTED))

    def _emit_stop(self, sample: LoadSample | StageSample, finding: Finding) -> None:
        """Emit the event of a stop: DeviceStopped for findings that the engine also derives from the reading, else DeviceFault."""
        device_stopped = finding.code in (FaultCode.LIMIT, FaultCode.UNORDERED_MOTION)
        event = DeviceStopped if device_stopped else DeviceFault
        self._device.emit(event(sample.time_ns, self._device.kind, finding.reason, code=finding.code))
