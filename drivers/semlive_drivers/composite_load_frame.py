"""The LoadFrame port over parts: a single device, or several devices such as load cell, drive and strain gage."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterable, Mapping, Sequence

from pydantic import BaseModel, ConfigDict

from semlive.data.loading import ControlMode, DeviceIdentity, LoadSample, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.device_part import MOTIONS, WITHHELD, DevicePart, OrderHolder, Part, PartCommand, PartReading
from semlive_drivers.load_approach import ApproachSettings, ApproachState, ramp_problem, start, step

_NOISE_READINGS = 20
"""Readings at rest from whose differences the noise of the load is estimated."""


class FrameSettings(BaseModel):
    """Settings of the complete load frame, independent of its parts."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stop_on_link_loss: StopOnLinkLoss | None = None
    """Result of a test at this machine; None takes the statement of the device, which counts as assumed."""
    approach: ApproachSettings | None = None
    """Settings for loads on a machine without load control."""

    @classmethod
    def split(cls, settings: Mapping[str, object]) -> tuple[dict[str, object], dict[str, object]]:
        """Settings of the complete load frame, and settings of its parts."""
        frame_keys = {key: value for key, value in settings.items() if key in cls.model_fields}
        return frame_keys, {key: value for key, value in settings.items() if key not in frame_keys}


class CompositeLoadFrame:
    """One load frame made of parts; a value that several parts measure is taken from the first of them.

    A part with load control performs a ramp itself. Otherwise the drive is ordered to make short jogs, one with each reading and never
    before the link thread has checked the last sample: if semlive or the link fails, the machine stops at the end of the jog.

    Args:
        parts: open; closed with the frame.
        settings: settings of the complete load frame.
        clock: experiment time.

    Raises:
        BadConfig: if no part measures the load, or a displacement drive has no `approach`.
        LinkError: if a part gives no valid reading.
    """

    def __init__(self, parts: Sequence[Part], settings: FrameSettings, clock: ClockSource) -> None:
        self._parts, self._settings, self._clock = tuple(parts), settings, clock
        self._devices = [part for part in self._parts if isinstance(part, DevicePart)]
        # Withholding the heartbeat is the last method: it acts late, and lasts until the link is opened again.
        methods = (method for part in self._devices for method in part.stops.methods)
        self._methods = sorted(methods, key=lambda method: method.description == WITHHELD)
        self._sequence = 0
        self._loads_at_rest_n: deque[float] = deque(maxlen=_NOISE_READINGS)
        self._target_n = 0.0
        self._ramp: ApproachState | None = None
        self._ordered_mono_ns = 0
        self._may_move = self._stopped = False
        drives = [
            part
            for part in self._parts
            if part.capabilities & {PartCommand.JOG_TENSION, PartCommand.JOG_COMPRESSION} and PartCommand.RAMP not in part.capabilities
        ]
        self._load_control = next((part for part in self._parts if PartCommand.RAMP in part.capabilities), None)
        self._drive = drives[0] if drives else None
        if self._load_control is None and self._drive is not None and settings.approach is None:
            raise BadConfig(f"{self._drive.where} has no load control; give approach: {{stiffness_n_mm: ..., speed_max_mm_s: ...}}")
        readings = [part.identify() for part in self._parts]
        reading = merge_readings(readings)
        if reading.force_n is None:
            raise BadConfig(f"{self._where}: no part measures the load; name one that does (cell)")
        self._reading = reading
        force_step, extension_step = _resolution(self._parts, readings)
        self._identity = DeviceIdentity(
            name=f"load frame at {self._where}",
            simulated=bool(self._parts) and all(part.simulated for part in self._parts),
            stop_on_link_loss=_stop_on_link_loss(self._parts, settings),
            force_max_n=reading.force_max_n,
            control=self._control(),
            force_resolution_n=force_step,
            extension_resolution_mm=extension_step,
            measures_extension=reading.extension_mm is not None,
            stiffness_n_mm=None if settings.approach is None else settings.approach.stiffness_n_mm,
            rate_min_n_s=0.0 if settings.approach is None else settings.approach.stiffness_n_mm * settings.approach.speed_min_mm_s,
        )

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the devices, as read when the links were opened."""
        return self._identity

    def read(self) -> LoadSample:
        """Take a new reading of all parts; in displacement control, the next jog of a ramp is ordered first.

        Raises:
            LinkError: if no valid answer comes, the reading is frozen, or a ramp had to be aborted (the machine is then stopped).
        """
        changes = [(change, part) for part in self._devices if (change := part.order_changed()) is not None]
        changed, holder = changes[0] if changes else (None, None)
        if changed is not None:
            self._ramp = None  # no further jog while another program commands the machine
        self._continue_ramp()
        reading = self._reading = merge_readings([part.read() for part in self._parts])
        if reading.force_n is None:
            raise LinkError(f"{self._where} gives no load")
        sample = LoadSample(
            sequence=self._sequence,
            time_ns=self._clock.now_ns(),
            mono_ns=self._clock.mono_ns(),
            force_n=reading.force_n,
            extension_mm=reading.extension_mm or 0.0,
            motion=self._motion(reading),
            target_n=self._target_n if reading.target_n is None else reading.target_n,
            simulator_lag_s=reading.lag_s,
            raw=reading.raw,
            gage_strain=reading.gage_strain,
            trouble=reading.trouble,
            counted=reading.reading_counter,
            order_changed=changed,
            orders_cleared=isinstance(holder, OrderHolder) and holder.cleared,
        )
        self._sequence += 1
        if sample.motion is MotionState.STOPPED:
            self._loads_at_rest_n.append(reading.force_n)
        else:
            self._loads_at_rest_n.clear()
        return sample

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Start a ramp to a load, N, at a rate, N/s; returns after the device took the command.

        Raises:
            LinkError: if no part can move, or the device did not take the command.
        """
        if self._load_control is None and self._drive is None:
            raise LinkError(
                f"{self._where} cannot be moved by semlive; add a part that moves it (drive), or take the loads out of the plan"
            )
        self._stopped, self._may_move = False, True
        self._target_n = force_n
        if self._load_control is not None:
            self._load_control.command(PartCommand.RAMP, {"force_n": force_n, "rate_n_s": rate_n_s})
            return
        self._ramp = None
        reading = self._reading = merge_readings([part.read() for part in self._parts])
        if reading.force_n is None:
            raise LinkError(f"{self._where} gives no load to begin from")
        noise_n = max(self._loads_at_rest_n) - min(self._loads_at_rest_n) if self._loads_at_rest_n else 0.0
        self._ramp = start(force_n, rate_n_s, reading.force_n, reading.extension_mm or 0.0, noise_n)
        self._ordered_mono_ns = self._clock.mono_ns()
        self._continue_ramp()

    def recall_order(self, force_n: float, rate_n_s: float) -> None:
        """Compare the device from now on with a ramp that an earlier process ordered, as `semlive.ports.OrderRecall`; sends nothing.

        Only a device with load control stores the target of a ramp; a displacement drive stores the last jog, which is unknown.
        """
        if isinstance(self._load_control, OrderHolder):
            self._load_control.recall(PartCommand.RAMP, {"force_n": force_n, "rate_n_s": rate_n_s})

    def order_problem(self, force_n: float, rate_n_s: float) -> str | None:
        """Why a ramp cannot be ordered exactly, or None; sends nothing, as `semlive.ports.OrderCheck`."""
        mover = self._load_control or self._drive
        if not isinstance(mover, DevicePart):
            return None
        problem = ramp_problem(mover.book, self._settings.approach, force_n, rate_n_s)
        return None if problem is None else f"{mover.where}: {problem}"

    def stop(self) -> None:
        """Stop motion and hold position; returns after every part that moves took the command.

        Raises:
            LinkError: if a part did not take it.
        """
        self._ramp = None
        failures = []
        for part in self._parts:
            if PartCommand.STOP in part.capabilities:
                try:
                    part.command(PartCommand.STOP, {})
                except LinkError as error:
                    failures.append(error)
        if failures:
            raise failures[0]
        self._stopped, self._may_move = True, False

    @property
    def stop_methods(self) -> tuple[str, ...]:
        """Descriptions of the further stop methods of all parts, as `semlive.ports.StopMethods`."""
        return tuple(method.description for method in self._methods)

    def stop_by(self, method: int) -> None:
        """Stop by the further method of this index.

        Raises:
            LinkError: if it does not exist, or the device did not take it.
        """
        self._ramp = None
        if not 0 <= method < len(self._methods):
            raise LinkError(f"{self._where} has no stop method {method}; it has {', '.join(self.stop_methods) or 'none'}")
        self._methods[method].act()

    def stop_blind(self) -> bool:
        """Write a stop to every part that moves without waiting for an answer, as `semlive.ports.BlindStop`; never raises."""
        self._ramp = None
        return any([part.stops.blind() for part in self._devices if PartCommand.STOP in part.capabilities])

    def close(self) -> None:
        """Disarm the watchdog of a device that was stopped, or stop a device that may move; then close the links.

        An armed watchdog would expire after an orderly end, and the operator would have to clear the fault. A device that may be
        moving keeps its watchdog.
        """
        for part in self._parts:
            with contextlib.suppress(LinkError):
                if self._stopped and PartCommand.DISARM in part.capabilities and part.has_watchdog:
                    part.command(PartCommand.DISARM, {})
            if self._may_move and PartCommand.STOP in part.capabilities:
                part.blind_stop()
        for part in self._parts:
            part.close()

    @property
    def _where(self) -> str:
        return ", ".join(part.where for part in self._parts) or "nothing"

    def _continue_ramp(self) -> None:
        """Order the next jog of a ramp by the last reading, which the link thread has compared with the limits since."""
        drive, settings = self._drive, self._settings.approach
        if self._ramp is None or drive is None or settings is None or self._reading.force_n is None:
            return
        now = self._clock.mono_ns()
        since_s = (now - self._ordered_mono_ns) / 1e9
        self._ordered_mono_ns = now
        min_travel_mm = drive.book.step_of("travel_mm") if isinstance(drive, DevicePart) else 0.0
        ramp, jog = step(self._ramp, settings, self._reading.force_n, self._reading.extension_mm or 0.0, since_s, min_travel_mm)
        if self._reading.motion is MotionState.FAULT:
            jog, self._ramp = None, None
        if jog is not None:
            self._ramp = ramp
            drive.command(
                PartCommand.JOG_TENSION if jog.in_tension else PartCommand.JOG_COMPRESSION,
                {"travel_mm": jog.travel_mm, "speed_mm_s": jog.speed_mm_s},
            )
            return
        self.stop()
        if ramp.trouble:
            raise LinkError(ramp.trouble)

    def _motion(self, reading: PartReading) -> MotionState:
        if reading.motion is MotionState.FAULT:
            return MotionState.FAULT
        if self._ramp is not None or reading.motion is MotionState.MOVING:
            return MotionState.MOVING
        return MotionState.STOPPED

    def _control(self) -> ControlMode:
        mover = self._load_control or self._drive
        if mover is None or (isinstance(mover, DevicePart) and mover.manual):
            return ControlMode.MANUAL
        return ControlMode.LOAD if mover is self._load_control else ControlMode.DISPLACEMENT


def _resolution(parts: Sequence[Part], readings: Sequence[PartReading]) -> tuple[float, float]:
    """Smallest change of force, N, and of extension, mm, each of the first part that measures it; 0 where no number format sets one."""
    steps = [part.resolution() if isinstance(part, DevicePart) else (0.0, 0.0) for part in parts]
    measured = list(zip(steps, readings, strict=True))
    force_step_n = next((force_n for (force_n, _), reading in measured if reading.force_n is not None), 0.0)
    return force_step_n, next((extension_mm for (_, extension_mm), reading in measured if reading.extension_mm is not None), 0.0)


def _stop_on_link_loss(parts: Sequence[Part], settings: FrameSettings) -> StopOnLinkLoss:
    """Whether the machine stops when the link is lost: as configured, or else as its watchdogs state."""
    if settings.stop_on_link_loss is not None:
        return settings.stop_on_link_loss
    movers = [part for part in parts if part.capabilities & MOTIONS]
    return StopOnLinkLoss.ASSUMED if all(part.has_watchdog for part in movers) and movers else StopOnLinkLoss.NONE


def _first(values: Iterable[float | None]) -> float | None:
    return next((value for value in values if value is not None), None)


def merge_readings(readings: Sequence[PartReading]) -> PartReading:
    """One reading of all parts: each value from the first part that measures it, and the most critical motion state."""
    motions = {reading.motion for reading in readings} - {None}
    worst = next((state for state in (MotionState.FAULT, MotionState.MOVING, MotionState.STOPPED) if state in motions), None)
    return PartReading(
        force_n=_first(reading.force_n for reading in readings),
        extension_mm=_first(reading.extension_mm for reading in readings),
        motion=worst,
        target_n=_first(reading.target_n for reading in readings),
        lag_s=_first(reading.lag_s for reading in readings),
        force_max_n=_first(reading.force_max_n for reading in readings),
        gage_strain=_first(reading.gage_strain for reading in readings),
        raw=tuple(register for reading in readings for register in reading.raw),
        trouble=next((reading.trouble for reading in readings if reading.trouble is not None), None),
        reading_counter=next((reading.reading_counter for reading in readings if reading.reading_counter is not None), None),
    )


def compose(parts: Sequence[Part], settings: FrameSettings, clock: ClockSource) -> CompositeLoadFrame:
    """A load frame of open parts, which are closed if it cannot be made; arguments and errors as for `CompositeLoadFrame`."""
    try:
        return CompositeLoadFrame(parts, settings, clock)
    except SemliveError:
        for part in parts:
            part.close()
        raise
