"""Common interface of load frame and stage for the link thread: read, check, order and stop."""

from __future__ import annotations

import math
from typing import Protocol

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, LoadSample, StageSample
from semlive.engine.commands import MoveStage, RampTo
from semlive.engine.events import Event, LoadReading, StageReading
from semlive.engine.limits import sample_problem, with_device_limits
from semlive.engine.resume import order_code
from semlive.engine.supervision.load_watch import LoadSupervisor
from semlive.engine.supervision.operator_supervision import HandSupervision
from semlive.engine.supervision.ramp_readings import Finding
from semlive.engine.supervision.ramp_supervision import supervise
from semlive.errors import LinkError
from semlive.ports import LoadFrame, Stage, StopMethods
from semlive.service.device_link.stop_pursuit import Motionless

Order = RampTo | MoveStage


class Port(Protocol):
    """Interface of a load frame or a stage."""

    def read(self) -> LoadSample | StageSample:
        """Return a fresh reading; raises LinkError."""
        ...

    def event(self, sample: LoadSample | StageSample) -> Event:
        """Return the reading as an event."""
        ...

    def problem(self, sample: LoadSample | StageSample) -> Finding | None:
        """Return why the device must stop, from this and earlier readings, or None."""
        ...

    def obey(self, order: Order) -> None:
        """Order a motion; raises LinkError."""
        ...

    def stop(self) -> None:
        """Stop the device; repeated calls use all stop methods in turn. Raises LinkError."""
        ...

    def still(self) -> Motionless | None:
        """Return the thresholds of no motion; None if only the motion report of the device is used."""
        ...


class LoadFramePort:
    """Port of a load frame: limits, sudden changes, and supervision of the present ramp."""

    def __init__(self, device: LoadFrame, limits: Limits) -> None:
        self._device = device
        self._limits = with_device_limits(limits, device.identity)
        self._watch = LoadSupervisor()
        self._supervision = supervise(self._limits, device.identity)
        manual = device.identity.control is ControlMode.MANUAL and device.identity.measures_extension
        self._hand = HandSupervision(self._limits) if manual else None
        self._rate_n_s, self._sign = self._limits.force_rate_max_n_s, 0.0
        self._stops = 0

    def read(self) -> LoadSample:
        """Return a fresh reading."""
        return self._device.read()

    def event(self, sample: LoadSample | StageSample) -> Event:
        """Return the reading as an event."""
        assert isinstance(sample, LoadSample)
        return LoadReading(sample.time_ns, sample)

    def problem(self, sample: LoadSample | StageSample) -> Finding | None:
        """Return a violated limit, a sudden change, or a finding of the ramp supervision; None if there is none."""
        assert isinstance(sample, LoadSample)
        self._watch, sudden_change = self._watch.with_sample(self._limits, sample)
        ramping = self._supervision.ramp is not None
        self._supervision, finding = self._supervision.with_sample(sample)
        if self._hand is not None:
            self._hand, finding = self._hand.with_sample(sample)
        violation = sample_problem(self._limits, sample) or sudden_change
        if violation is not None:
            return Finding(FaultCode.LIMIT, violation)
        if ramping and sample.order_changed is not None:
            return Finding(order_code(sample), sample.order_changed)
        return finding

    def obey(self, order: Order) -> None:
        """Ramp to a load."""
        if not isinstance(order, RampTo):
            raise LinkError(f"a load frame cannot do {order}")
        self._supervision = self._supervision.ordered(order.force_n, order.rate_n_s, order.tolerance_n)
        if self._hand is not None:
            self._hand = self._hand.ordered(order.rate_n_s, order.tolerance_n)
        ramp = self._supervision.ramp
        self._rate_n_s, self._sign = order.rate_n_s, 0.0 if ramp is None else ramp.sign
        self._stops = 0
        self._device.ramp_to(order.force_n, order.rate_n_s)

    def stop(self) -> None:
        """Send the standard stop; every second repetition from the third stop on uses another stop method.

        If the standard stop fails, all other methods are tried before the error is raised.
        """
        self._supervision = self._supervision.stopped()
        methods = len(self._device.stop_methods) if isinstance(self._device, StopMethods) else 0
        sent, self._stops = self._stops, self._stops + 1
        if methods and sent >= 2 and sent % 2 == 0:
            self._stop_by((sent // 2 - 1) % methods)
            return
        try:
            self._device.stop()
        except LinkError:
            for method in range(methods):
                self._stop_by(method)
            raise

    def _stop_by(self, method: int) -> None:
        if isinstance(self._device, StopMethods):
            self._device.stop_by(method)

    def still(self) -> Motionless | None:
        """Return the noise of the readings, and rate and direction of the last ramp; None for a manually operated machine."""
        supervision = self._supervision
        if supervision.identity.control is ControlMode.MANUAL:
            return None
        # The noise cannot be estimated from few readings; then only the motion report of the device is used.
        force_n, extension_mm = (
            noise.noticeable() if noise.sufficient else math.inf for noise in (supervision.force_noise, supervision.extension_noise)
        )
        return Motionless(force_n, extension_mm, self._rate_n_s, self._sign)


class StagePort:
    """Port of a stage; its travel is limited by the check of the plan."""

    def __init__(self, device: Stage) -> None:
        self._device = device

    def read(self) -> StageSample:
        """Return a fresh reading."""
        return self._device.read()

    def event(self, sample: LoadSample | StageSample) -> Event:
        """Return the reading as an event."""
        assert isinstance(sample, StageSample)
        return StageReading(sample.time_ns, sample)

    def problem(self, sample: LoadSample | StageSample) -> Finding | None:
        """Return None: the readings of a stage are not checked here."""
        return None

    def obey(self, order: Order) -> None:
        """Move to a position."""
        if not isinstance(order, MoveStage):
            raise LinkError(f"a stage cannot do {order}")
        self._device.move_to(order.x_um, order.y_um)

    def stop(self) -> None:
        """Send the standard stop."""
        self._device.stop()

    def still(self) -> Motionless | None:
        """Return None: the motion report of the stage is used."""
        return None


def port_of(device: LoadFrame | Stage, limits: Limits) -> Port:
    """Return the port of a device."""
    return LoadFramePort(device, limits) if isinstance(device, LoadFrame) else StagePort(device)
