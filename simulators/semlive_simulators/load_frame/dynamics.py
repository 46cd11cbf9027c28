"""How the load frame moves: pure functions of a state and a stretch of experiment time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import ConfigDict


@dataclass(frozen=True, slots=True)
class LoadFrameParameters:
    """What kind of machine it is.

    Attributes:
        machine_stiffness_n_mm: of everything in series with the specimen.
        approach_time_s: time constant of the last part of a ramp.
        arrived_n: the ramp is over this close to its target; the position is held from there on.
        relaxation_fraction: part of the load that is lost at held position.
        relaxation_time_s: time constant of that loss.
        force_limit_n: beyond this the machine stops with a fault.
        cell_noise_n: standard deviation of one reading of the load cell.
        extension_noise_mm: standard deviation of one reading of the crosshead.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    machine_stiffness_n_mm: float
    approach_time_s: float
    arrived_n: float
    relaxation_fraction: float
    relaxation_time_s: float
    force_limit_n: float
    cell_noise_n: float
    extension_noise_mm: float


class Drive(StrEnum):
    """What the drive is doing."""

    HOLDING = "holding"
    RAMPING = "ramping"
    OVERLOAD = "overload"
    WATCHDOG = "watchdog"


@dataclass(frozen=True, slots=True)
class LoadFrameState:
    """The machine at an instant.

    Attributes:
        drive: what it does; two of its words are faults.
        target_n: where the last ramp went.
        rate_n_s: how fast.
        stiffness_n_mm: of machine and specimen in series.
        extension_mm: of the crosshead.
        relaxed_n: load lost by relaxation so far.
    """

    stiffness_n_mm: float
    drive: Drive = Drive.HOLDING
    target_n: float = 0.0
    rate_n_s: float = 0.0
    extension_mm: float = 0.0
    relaxed_n: float = 0.0

    @property
    def force_n(self) -> float:
        """True force on the specimen."""
        return self.stiffness_n_mm * self.extension_mm - self.relaxed_n

    @property
    def faulty(self) -> bool:
        """Whether it stopped with a fault."""
        return self.drive in (Drive.OVERLOAD, Drive.WATCHDOG)


def at_rest(parameters: LoadFrameParameters, specimen_stiffness_n_mm: float) -> LoadFrameState:
    """An unloaded machine with a specimen in its grips."""
    return LoadFrameState(1.0 / (1.0 / specimen_stiffness_n_mm + 1.0 / parameters.machine_stiffness_n_mm))


def ramp_to(state: LoadFrameState, target_n: float, rate_n_s: float) -> LoadFrameState:
    """Start going to a load in load control; also acknowledges a watchdog fault."""
    return replace(state, drive=Drive.RAMPING, target_n=target_n, rate_n_s=rate_n_s)


def stop(state: LoadFrameState) -> LoadFrameState:
    """Stop and hold position; acknowledges a fault. The target becomes the present load."""
    return replace(state, drive=Drive.HOLDING, target_n=state.force_n)


def expire(state: LoadFrameState) -> LoadFrameState:
    """The watchdog expired: stop, hold position, say so."""
    return state if state.faulty else replace(state, drive=Drive.WATCHDOG, target_n=state.force_n)


def step(state: LoadFrameState, parameters: LoadFrameParameters, dt_s: float) -> LoadFrameState:
    """The machine `dt_s` of experiment time later.

    A ramp runs at its rate and closes the last part exponentially; grips and machine creep all the while, which load control
    makes good and a held position shows as falling load.
    """
    lost = parameters.relaxation_fraction * state.stiffness_n_mm * state.extension_mm
    relaxed = lost + (state.relaxed_n - lost) * math.exp(-dt_s / parameters.relaxation_time_s)
    moved = replace(state, relaxed_n=relaxed)
    if state.drive is Drive.RAMPING:
        missing = state.target_n - moved.force_n
        most = state.rate_n_s * dt_s
        change = max(-most, min(most, -missing * math.expm1(-dt_s / parameters.approach_time_s)))
        moved = replace(moved, extension_mm=state.extension_mm + change / state.stiffness_n_mm)
        if abs(state.target_n - moved.force_n) <= parameters.arrived_n:
            moved = replace(moved, drive=Drive.HOLDING)
    if abs(moved.force_n) > parameters.force_limit_n and moved.drive is not Drive.OVERLOAD and not _unloading(moved):
        moved = replace(moved, drive=Drive.OVERLOAD)
    return moved


def _unloading(state: LoadFrameState) -> bool:
    return state.drive is Drive.RAMPING and abs(state.target_n) < abs(state.force_n)
