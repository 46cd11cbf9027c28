"""A machine of numbers under supervision, with faults of its readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from semlive.data.experiment import Limits
from semlive.data.loading import ControlMode, DeviceIdentity, LoadSample, MotionState, StopOnLinkLoss
from semlive.engine.supervision.ramp_readings import Finding
from semlive.engine.supervision.ramp_supervision import supervise

S = 1_000_000_000
LIMITS = Limits(-50.0, 400.0, -0.5, 2.0, 200.0, 500.0, 100.0)
LOAD = DeviceIdentity("machine", simulated=True, stop_on_link_loss=StopOnLinkLoss.NONE)
DRIVE = replace(LOAD, control=ControlMode.DISPLACEMENT, stiffness_n_mm=20_000.0)
STIFFNESS = 20_000.0


@dataclass
class Machine:
    """A specimen of 20000 N/mm and what a sensor makes of it; independent of the supervision."""

    rate_n_s: float = 30.0
    target_n: float = 300.0
    force_n: float = 0.0
    ends: bool = True
    delay_s: float = 0.0
    shown: Callable[[float, float], float] = lambda force_n, t_s: force_n
    shown_mm: Callable[[float], float] = lambda mm: mm
    reports: Callable[[bool, float], bool] = lambda moving, t_s: moving

    def samples(self, seconds: float, poll_s: float = 0.05, rest_s: float = 2.0) -> Iterator[tuple[float, LoadSample, bool]]:
        """(true force, sample, whether the order comes after it); the order comes after `rest_s`."""
        count, moving, t_order = 0, False, None
        t = 0.0
        while t < seconds + rest_s:
            if t_order is not None and moving and t - t_order >= self.delay_s:
                step = self.rate_n_s * poll_s
                remaining_n = self.target_n - self.force_n
                if self.ends and abs(remaining_n) <= step:
                    self.force_n, moving = self.target_n, False
                else:
                    self.force_n += math.copysign(step, self.target_n - self.force_n) if self.ends else step
            order = t_order is None and t >= rest_s
            since = 0.0 if t_order is None else t - t_order
            force = self.shown(self.force_n, since)
            motion = MotionState.MOVING if self.reports(moving, since) else MotionState.STOPPED
            now = 1_000 * S + round(t * S)
            yield self.force_n, LoadSample(count, now, now, force, self.shown_mm(self.force_n / STIFFNESS), motion, 0.0), order
            if order:
                t_order, moving = t, True
            count, t = count + 1, t + poll_s


def first_finding(
    machine: Machine,
    identity: DeviceIdentity = LOAD,
    *,
    seconds: float = 60.0,
    ordered_n: float = 300.0,
    ordered_n_s: float = 30.0,
    tolerance_n: float = 3.0,
    limits: Limits = LIMITS,
    poll_s: float = 0.05,
) -> tuple[Finding | None, float]:
    """The first finding, and the true force at which it was made (or the last)."""
    supervision, true_n = supervise(limits, identity), 0.0
    for true_n, sample, order in machine.samples(seconds, poll_s):
        supervision, finding = supervision.with_sample(sample)
        if finding is not None:
            return finding, true_n
        if order:
            supervision = supervision.ordered(ordered_n, ordered_n_s, tolerance_n)
    return None, true_n


def frozen_from(t0_s: float) -> Callable[[float, float], float]:
    """A reading that is frozen from `t0_s` after the order."""
    stored: list[float] = []

    def shown(force_n: float, t_s: float) -> float:
        if t_s < t0_s:
            return force_n
        stored.append(force_n)
        return stored[0]

    return shown


def all_frozen_from(t0_s: float) -> Machine:
    """A device whose measurements are all frozen from `t0_s` after the order, while it continues to move."""
    stored: list[float] = []

    def shown(force_n: float, t_s: float) -> float:
        if t_s >= t0_s and not stored:
            stored.append(force_n)
        return stored[0] if stored else force_n

    return Machine(ends=False, shown=shown, shown_mm=lambda mm: min(mm, stored[0] / STIFFNESS) if stored else mm)


def stepped(lsb_mm: float) -> Callable[[float], float]:
    """An extension sensor with a coarse resolution."""
    return lambda mm: round(mm / lsb_mm) * lsb_mm
