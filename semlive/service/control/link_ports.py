"""A load frame and a stage as the link thread sees them: one way to read, to judge, to order and to stop."""

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
from semlive.service.control.stop_pursuit import Motionless

Order = RampTo | MoveStage


class Port(Protocol):
    """A load frame or a stage, seen alike."""

    def read(self) -> LoadSample | StageSample:
        """One fresh reading; raises LinkError."""
        ...

    def event(self, sample: LoadSample | StageSample) -> Event:
        """The reading as an event."""
        ...

    def problem(self, sample: LoadSample | StageSample) -> Finding | None:
        """Why the device must stop, as this reading and the ones before show."""
        ...

    def obey(self, order: Order) -> None:
        """Order a motion; raises LinkError."""
        ...

    def stop(self) -> None:
        """Stop; when it is called again and again, every way to stop is used in turn. Raises LinkError."""
        ...

    def still(self) -> Motionless | None:
        """What counts as no motion; None for a device whose report of motion is all there is."""
        ...


class LoadFramePort:
    """The port of a load frame: limits, sudden changes, and the supervision of the ramp under way."""

    def __init__(self, device: LoadFrame, limits: Limits) -> None:
        self._device = device
        self._limits = with_device_limits(limits, device.identity)
        self._watch = LoadSupervisor()
        self._supervision = supervise(self._limits, device.identity)
        by_hand = device.identity.control is ControlMode.MANUAL and device.identity.measures_extension
        self._hand = HandSupervision(self._limits) if by_hand else None
        self._rate_n_s, self._sign = self._limits.force_rate_max_n_s, 0.0
        self._stops = 0

    def read(self) -> LoadSample:
        """One fresh reading."""
        return self._device.read()

    def event(self, sample: LoadSample | StageSample) -> Event:
        """The reading as an event."""
        assert isinstance(sample, LoadSample)
        return LoadReading(sample.time_ns, sample)

    def problem(self, sample: LoadSample | StageSample) -> Finding | None:
        """A violated limit, a sudden change, or a ramp that the readings do not answer."""
        assert isinstance(sample, LoadSample)
        self._watch, sudden = self._watch.with_sample(self._limits, sample)
        ramping = self._supervision.ramp is not None
        self._supervision, finding = self._supervision.with_sample(sample)
        if self._hand is not None:
            self._hand, finding = self._hand.with_sample(sample)
        beyond = sample_problem(self._limits, sample) or sudden
        if beyond is not None:
            return Finding(FaultCode.LIMIT, beyond)
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
        """The plain stop, and from the third on the device's other ways between; one that is refused does not keep from the next."""
        self._supervision = self._supervision.stopped()
        others = len(self._device.stop_methods) if isinstance(self._device, StopMethods) else 0
        sent, self._stops = self._stops, self._stops + 1
        if others and sent >= 2 and sent % 2 == 0:
            self._stop_by((sent // 2 - 1) % others)
            return
        try:
            self._device.stop()
        except LinkError:
            for method in range(others):
                self._stop_by(method)
            raise

    def _stop_by(self, method: int) -> None:
        if isinstance(self._device, StopMethods):
            self._device.stop_by(method)

    def still(self) -> Motionless | None:
        """Noise of the readings, and the last ramp."""
        seen = self._supervision
        if seen.identity.control is ControlMode.MANUAL:
            return None
        # Of few readings nobody knows which differences are noise: then the device's own report of motion is all there is.
        force_n, extension_mm = (one.noticeable() if one.known else math.inf for one in (seen.force_noise, seen.extension_noise))
        return Motionless(force_n, extension_mm, self._rate_n_s, self._sign)


class StagePort:
    """The port of a stage; its travel is bounded by the plan's own check."""

    def __init__(self, device: Stage) -> None:
        self._device = device

    def read(self) -> StageSample:
        """One fresh reading."""
        return self._device.read()

    def event(self, sample: LoadSample | StageSample) -> Event:
        """The reading as an event."""
        assert isinstance(sample, StageSample)
        return StageReading(sample.time_ns, sample)

    def problem(self, sample: LoadSample | StageSample) -> Finding | None:
        """Nothing: a stage has no limits of its own here."""
        return None

    def obey(self, order: Order) -> None:
        """Move to a position."""
        if not isinstance(order, MoveStage):
            raise LinkError(f"a stage cannot do {order}")
        self._device.move_to(order.x_um, order.y_um)

    def stop(self) -> None:
        """The plain stop, each time."""
        self._device.stop()

    def still(self) -> Motionless | None:
        """Its own report of motion is believed."""
        return None


def port_of(device: LoadFrame | Stage, limits: Limits) -> Port:
    """The port of a device."""
    return LoadFramePort(device, limits) if isinstance(device, LoadFrame) else StagePort(device)
