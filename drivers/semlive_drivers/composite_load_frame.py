"""The LoadFrame port over parts: one device that does everything, or a load cell here, a drive there and a strain gage elsewhere."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterable, Mapping, Sequence

from pydantic import BaseModel, ConfigDict

from semlive.data.loading import ControlMode, DeviceIdentity, LoadSample, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError
from semlive.ports import ClockSource
from semlive_drivers.device_part import MOTIONS, WITHHELD, DevicePart, OrderHolder, Part, PartCommand, PartReading
from semlive_drivers.load_approach import ApproachSettings, ApproachState, ramp_problem, start, step

_AT_REST = 20
"""Readings at rest whose differences tell the noise of the load."""


class FrameSettings(BaseModel):
    """What concerns a load frame as a whole."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stop_on_link_loss: StopOnLinkLoss | None = None
    """What was found out at this machine; None believes the device's own word, which counts as assumed."""
    approach: ApproachSettings | None = None
    """How a machine that only knows displacement is brought to a load."""

    @classmethod
    def split(cls, settings: Mapping[str, object]) -> tuple[dict[str, object], dict[str, object]]:
        """Settings of the frame as a whole, and the rest."""
        own = {key: value for key, value in settings.items() if key in cls.model_fields}
        return own, {key: value for key, value in settings.items() if key not in own}


class CompositeLoadFrame:
    """One load frame made of parts; what several of them tell is taken from the first.

    A ramp is the device's own where one has load control. Otherwise the drive is sent short ways, one with each reading and never
    before the link thread has judged the last sample: whoever falls silent leaves a machine that stops by itself.

    Args:
        parts: open; closed with the frame.
        settings: of the whole.
        clock: experiment time.

    Raises:
        BadConfig: if nobody tells a load, or a displacement drive has no `approach`.
        LinkError: if somebody gives no sensible reading.
    """

    def __init__(self, parts: Sequence[Part], settings: FrameSettings, clock: ClockSource) -> None:
        self._parts, self._settings, self._clock = tuple(parts), settings, clock
        self._devices = [part for part in self._parts if isinstance(part, DevicePart)]
        # A watchdog that is withheld comes last: its effect takes time, and nothing ends it before the link is opened again.
        self._ways = sorted((way for part in self._devices for way in part.stops.ways), key=lambda way: way.says == WITHHELD)
        self._sequence = 0
        self._at_rest: deque[float] = deque(maxlen=_AT_REST)
        self._target_n = 0.0
        self._ramp: ApproachState | None = None
        self._ordered_mono_ns = 0
        self._may_move = self._stopped = False
        drives = [
            part
            for part in self._parts
            if part.capabilities & {PartCommand.JOG_TENSION, PartCommand.JOG_COMPRESSION} and PartCommand.RAMP not in part.capabilities
        ]
        self._takes_loads = next((part for part in self._parts if PartCommand.RAMP in part.capabilities), None)
        self._drive = drives[0] if drives else None
        if self._takes_loads is None and self._drive is not None and settings.approach is None:
            raise BadConfig(f"{self._drive.where} knows no load; give approach: {{stiffness_n_mm: ..., speed_max_mm_s: ...}}")
        each = [part.identify() for part in self._parts]
        said = merge_readings(each)
        if said.force_n is None:
            raise BadConfig(f"{self._where}: nobody tells the load; name a part that does (cell)")
        self._said = said
        force_step, extension_step = self._resolution(each)
        self._identity = DeviceIdentity(
            name=f"load frame at {self._where}",
            simulated=bool(self._parts) and all(part.simulated for part in self._parts),
            stop_on_link_loss=self._statement(),
            force_max_n=said.force_max_n,
            control=self._control(),
            force_resolution_n=force_step,
            extension_resolution_mm=extension_step,
            measures_extension=said.extension_mm is not None,
            stiffness_n_mm=None if settings.approach is None else settings.approach.stiffness_n_mm,
            rate_min_n_s=0.0 if settings.approach is None else settings.approach.stiffness_n_mm * settings.approach.speed_min_mm_s,
        )

    @property
    def identity(self) -> DeviceIdentity:
        """Who answers, as read when the link was opened."""
        return self._identity

    def read(self) -> LoadSample:
        """One fresh reading of all parts; a ramp in displacement control is taken one way further first.

        Raises:
            LinkError: if nothing sensible comes back, the reading is frozen, or a ramp had to be given up (the machine is then stopped).
        """
        changes = [(found, part) for part in self._devices if (found := part.order_changed()) is not None]
        changed, holder = changes[0] if changes else (None, None)
        if changed is not None:
            self._ramp = None  # nothing more is ordered while somebody else commands the machine
        self._go_on()
        said = self._said = merge_readings([part.read() for part in self._parts])
        if said.force_n is None:
            raise LinkError(f"{self._where} gives no load")
        sample = LoadSample(
            sequence=self._sequence,
            time_ns=self._clock.now_ns(),
            mono_ns=self._clock.mono_ns(),
            force_n=said.force_n,
            extension_mm=said.extension_mm or 0.0,
            motion=self._motion(said),
            target_n=self._target_n if said.target_n is None else said.target_n,
            simulator_lag_s=said.lag_s,
            raw=said.raw,
            gage_strain=said.gage_strain,
            trouble=said.trouble,
            counted=said.reading_counter,
            order_changed=changed,
            orders_cleared=isinstance(holder, OrderHolder) and holder.cleared,
        )
        self._sequence += 1
        if sample.motion is MotionState.STOPPED:
            self._at_rest.append(said.force_n)
        else:
            self._at_rest.clear()
        return sample

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Start going to a load at a rate; returns when the device has taken the command.

        Raises:
            LinkError: if nobody can, or the device did not take it.
        """
        if self._takes_loads is None and self._drive is None:
            raise LinkError(f"{self._where} cannot be moved by semlive; add a part that pulls (drive), or take the loads out of the plan")
        self._stopped, self._may_move = False, True
        self._target_n = force_n
        if self._takes_loads is not None:
            self._takes_loads.command(PartCommand.RAMP, {"force_n": force_n, "rate_n_s": rate_n_s})
            return
        self._ramp = None
        said = self._said = merge_readings([part.read() for part in self._parts])
        if said.force_n is None:
            raise LinkError(f"{self._where} gives no load to begin from")
        noise_n = max(self._at_rest) - min(self._at_rest) if self._at_rest else 0.0
        self._ramp = start(force_n, rate_n_s, said.force_n, said.extension_mm or 0.0, noise_n)
        self._ordered_mono_ns = self._clock.mono_ns()
        self._go_on()

    def recall_order(self, force_n: float, rate_n_s: float) -> None:
        """Compare the device from now on with a ramp that an earlier process ordered, as `semlive.ports.OrderRecall`; sends nothing.

        Only a device that takes loads holds the target of a ramp; what a displacement drive holds is a short travel that is not known.
        """
        if isinstance(self._takes_loads, OrderHolder):
            self._takes_loads.recall(PartCommand.RAMP, {"force_n": force_n, "rate_n_s": rate_n_s})

    def order_problem(self, force_n: float, rate_n_s: float) -> str | None:
        """Why a ramp cannot be ordered as it is meant, or None; sends nothing, as `semlive.ports.OrderCheck`."""
        mover = self._takes_loads or self._drive
        if not isinstance(mover, DevicePart):
            return None
        found = ramp_problem(mover.book, self._settings.approach, force_n, rate_n_s)
        return None if found is None else f"{mover.where}: {found}"

    def stop(self) -> None:
        """Stop motion and hold position; returns when every part that moves has taken it.

        Raises:
            LinkError: if one did not take it.
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
        """Further ways to stop of all parts, in words, as `semlive.ports.StopMethods`."""
        return tuple(way.says for way in self._ways)

    def stop_by(self, method: int) -> None:
        """Stop by the way of this index.

        Raises:
            LinkError: if there is none, or the device did not take it.
        """
        self._ramp = None
        if not 0 <= method < len(self._ways):
            raise LinkError(f"{self._where} has no stop method {method}; it has {', '.join(self.stop_methods) or 'none'}")
        self._ways[method].act()

    def stop_blind(self) -> bool:
        """Write a stop to every part that moves without waiting for an answer, as `semlive.ports.BlindStop`; never raises."""
        self._ramp = None
        return any([part.stops.blind() for part in self._devices if PartCommand.STOP in part.capabilities])

    def close(self) -> None:
        """Close the links; a device that was stopped is told not to expect us any more, one that may move is told to stop.

        Otherwise its watchdog would expire after an orderly end and leave it in a fault that somebody has to clear. A
        device that may be moving keeps its watchdog.
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

    def _go_on(self) -> None:
        """Order the next way of a ramp, judged by the last reading; that reading has been held against the limits meanwhile."""
        drive, settings = self._drive, self._settings.approach
        if self._ramp is None or drive is None or settings is None or self._said.force_n is None:
            return
        now = self._clock.mono_ns()
        since_s = (now - self._ordered_mono_ns) / 1e9
        self._ordered_mono_ns = now
        least_mm = drive.book.step_of("travel_mm") if isinstance(drive, DevicePart) else 0.0
        ramp, go = step(self._ramp, settings, self._said.force_n, self._said.extension_mm or 0.0, since_s, least_mm)
        if self._said.motion is MotionState.FAULT:
            go, self._ramp = None, None
        if go is not None:
            self._ramp = ramp
            drive.command(
                PartCommand.JOG_TENSION if go.in_tension else PartCommand.JOG_COMPRESSION,
                {"travel_mm": go.travel_mm, "speed_mm_s": go.speed_mm_s},
            )
            return
        self.stop()
        if ramp.trouble:
            raise LinkError(ramp.trouble)

    def _motion(self, said: PartReading) -> MotionState:
        if said.motion is MotionState.FAULT:
            return MotionState.FAULT
        if self._ramp is not None or said.motion is MotionState.MOVING:
            return MotionState.MOVING
        return MotionState.STOPPED

    def _control(self) -> ControlMode:
        mover = self._takes_loads or self._drive
        if mover is None or (isinstance(mover, DevicePart) and mover.manual):
            return ControlMode.MANUAL
        return ControlMode.LOAD if mover is self._takes_loads else ControlMode.DISPLACEMENT

    def _resolution(self, each: Sequence[PartReading]) -> tuple[float, float]:
        """Steps of force and extension, each of the part that tells it; 0 where no number format sets one."""
        told = [
            (part.resolution() if isinstance(part, DevicePart) else (0.0, 0.0), said) for part, said in zip(self._parts, each, strict=True)
        ]
        force = next((steps[0] for steps, said in told if said.force_n is not None), 0.0)
        return force, next((steps[1] for steps, said in told if said.extension_mm is not None), 0.0)

    def _statement(self) -> StopOnLinkLoss:
        """What is known of the machine's own stop: what was found out at it, else its own word, else the short ways that it is sent."""
        if self._settings.stop_on_link_loss is not None:
            return self._settings.stop_on_link_loss
        movers = [part for part in self._parts if part.capabilities & MOTIONS]
        return StopOnLinkLoss.ASSUMED if all(part.has_watchdog for part in movers) and movers else StopOnLinkLoss.NONE


def _first(values: Iterable[float | None]) -> float | None:
    return next((value for value in values if value is not None), None)


def merge_readings(told: Sequence[PartReading]) -> PartReading:
    """What all parts say as one: each value from the first that tells it, motion from whoever says the worst."""
    motions = {said.motion for said in told} - {None}
    worst = next((state for state in (MotionState.FAULT, MotionState.MOVING, MotionState.STOPPED) if state in motions), None)
    return PartReading(
        force_n=_first(said.force_n for said in told),
        extension_mm=_first(said.extension_mm for said in told),
        motion=worst,
        target_n=_first(said.target_n for said in told),
        lag_s=_first(said.lag_s for said in told),
        force_max_n=_first(said.force_max_n for said in told),
        gage_strain=_first(said.gage_strain for said in told),
        raw=tuple(word for said in told for word in said.raw),
        trouble=next((said.trouble for said in told if said.trouble is not None), None),
        reading_counter=next((said.reading_counter for said in told if said.reading_counter is not None), None),
    )
