"""How the load frame moves: pure functions of a state and a stretch of experiment time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

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
        extension_min_mm: where the lower limit switch sits.
        extension_max_mm: where the upper one sits.
        slip_n: the grips slip when the force first exceeds this.
        slip_mm: how far they slip.
        fracture_n: the specimen breaks beyond this force.
        cell_resolution_n: step of the load cell's readings, which are whole multiples of it; 0 is none.
        hold: what is held after a ramp: the ``position``, so that the load relaxes, or the ``load``, so that the crosshead creeps on.
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
    extension_min_mm: float = -5.0
    extension_max_mm: float = 20.0
    slip_n: float = math.inf
    slip_mm: float = 0.0
    fracture_n: float = math.inf
    cell_resolution_n: float = 0.0
    hold: Literal["position", "load"] = "position"

    def __post_init__(self) -> None:
        if not 0.0 <= self.cell_resolution_n < math.inf:
            raise ValueError(f"cell_resolution_n must be at least 0, not {self.cell_resolution_n}")

    def resolved_n(self, force_n: float) -> float:
        """A force as the load cell can say it."""
        return self.cell_resolution_n * round(force_n / self.cell_resolution_n) if self.cell_resolution_n else force_n


class Drive(StrEnum):
    """What the drive is doing."""

    HOLDING = "holding"
    RAMPING = "ramping"
    JOGGING = "jogging"
    OVERLOAD = "overload"
    WATCHDOG = "watchdog"
    LIMIT = "limit switch"
    EMERGENCY = "emergency stop"


FAULTS = (Drive.OVERLOAD, Drive.WATCHDOG, Drive.LIMIT, Drive.EMERGENCY)


@dataclass(frozen=True, slots=True)
class LoadFrameState:
    """The machine at an instant.

    Attributes:
        drive: what it does; some of its words are faults.
        target_n: where the last ramp went.
        rate_n_s: how fast.
        jog_mm_s: crosshead speed in displacement control, positive pulls.
        jog_to_mm: extension at which that ends.
        keeps_load: whether load control goes on while it holds.
        stiffness_n_mm: of machine and specimen in series.
        extension_mm: of the crosshead.
        relaxed_n: load lost by relaxation so far.
        slipped_mm: how far the grips have slipped.
        broken: whether the specimen is in two pieces.
        peak_n: highest force so far.
        plastic_mm: how much longer the specimen is for good.
    """

    stiffness_n_mm: float
    drive: Drive = Drive.HOLDING
    target_n: float = 0.0
    rate_n_s: float = 0.0
    extension_mm: float = 0.0
    relaxed_n: float = 0.0
    jog_mm_s: float = 0.0
    jog_to_mm: float = math.inf
    keeps_load: bool = False
    slipped_mm: float = 0.0
    broken: bool = False
    peak_n: float = 0.0
    plastic_mm: float = 0.0

    @property
    def force_n(self) -> float:
        """True force on the specimen."""
        return 0.0 if self.broken else self.elastic_n - self.relaxed_n

    @property
    def elastic_n(self) -> float:
        """The force if nothing relaxed."""
        return self.stiffness_n_mm * (self.extension_mm - self.slipped_mm - self.plastic_mm)

    @property
    def moving(self) -> bool:
        """Whether the crosshead is driven."""
        return self.drive in (Drive.RAMPING, Drive.JOGGING)

    @property
    def faulty(self) -> bool:
        """Whether it stopped with a fault."""
        return self.drive in FAULTS


def at_rest(parameters: LoadFrameParameters, specimen_stiffness_n_mm: float) -> LoadFrameState:
    """An unloaded machine with a specimen in its grips."""
    return LoadFrameState(1.0 / (1.0 / specimen_stiffness_n_mm + 1.0 / parameters.machine_stiffness_n_mm))


def ramp_to(state: LoadFrameState, target_n: float, rate_n_s: float) -> LoadFrameState:
    """Start going to a load in load control; also acknowledges a watchdog fault."""
    return replace(state, drive=Drive.RAMPING, target_n=target_n, rate_n_s=rate_n_s, keeps_load=False)


def jog(state: LoadFrameState, speed_mm_s: float) -> LoadFrameState:
    """Start moving in displacement control, positive pulls; also acknowledges a watchdog fault."""
    return replace(state, drive=Drive.JOGGING, jog_mm_s=speed_mm_s, jog_to_mm=math.copysign(math.inf, speed_mm_s), keeps_load=False)


def travel_to(state: LoadFrameState, extension_mm: float, speed_mm_s: float) -> LoadFrameState:
    """Start going to an extension in displacement control, then hold it; also acknowledges a watchdog fault."""
    return replace(jog(state, math.copysign(speed_mm_s, extension_mm - state.extension_mm)), jog_to_mm=extension_mm)


def stop(state: LoadFrameState) -> LoadFrameState:
    """Stop and hold position; acknowledges a fault. The target becomes the present load."""
    return replace(state, drive=Drive.HOLDING, target_n=state.force_n, keeps_load=False)


def trip_watchdog(state: LoadFrameState) -> LoadFrameState:
    """The watchdog expired: stop, hold position, say so."""
    return state if state.faulty else with_fault(state, Drive.WATCHDOG)


def with_fault(state: LoadFrameState, fault: Drive) -> LoadFrameState:
    """Stopped by a fault, holding position."""
    return replace(state, drive=fault, target_n=state.force_n, keeps_load=False)


def slip(state: LoadFrameState, slip_mm: float) -> LoadFrameState:
    """The grips let the specimen go a little and hold again."""
    return replace(state, slipped_mm=state.slipped_mm + slip_mm)


def fracture(state: LoadFrameState) -> LoadFrameState:
    """The specimen breaks; the machine does not know."""
    return replace(state, broken=True)


def elastic(peak_n: float) -> float:
    """A specimen that never gets longer for good."""
    return 0.0 * peak_n


def step(
    state: LoadFrameState, parameters: LoadFrameParameters, dt_s: float, elongation_mm: Callable[[float], float] = elastic
) -> LoadFrameState:
    """The machine `dt_s` of experiment time later.

    Args:
        state: as it is.
        parameters: of the machine.
        dt_s: how much later.
        elongation_mm: how much longer the specimen is for good after a highest force, N; must not fall.

    A ramp runs at its rate and closes the last part exponentially; grips and machine creep all the while, which load control
    makes good, by a crosshead that creeps on, and a held position shows as falling load. With a broken specimen load control runs
    away to the limit switch.
    """
    lost = parameters.relaxation_fraction * state.elastic_n
    relaxed = lost + (state.relaxed_n - lost) * math.exp(-dt_s / parameters.relaxation_time_s)
    moved = replace(state, relaxed_n=relaxed)
    if state.drive is Drive.RAMPING or state.keeps_load:
        moved = _load_controlled(moved, parameters, dt_s, elongation_mm)
    elif state.drive is Drive.JOGGING:
        way_mm = state.jog_mm_s * dt_s
        there = abs(state.jog_to_mm - state.extension_mm) <= abs(way_mm)
        moved = replace(moved, extension_mm=state.jog_to_mm if there else state.extension_mm + way_mm)
        moved = stop(moved) if there else moved
    flowed = _flowing(_stopped_by_switch(moved, state, parameters), elongation_mm)
    return _overloaded(_yielding(flowed, parameters), parameters)


def _load_controlled(
    moved: LoadFrameState, parameters: LoadFrameParameters, dt_s: float, elongation_mm: Callable[[float], float]
) -> LoadFrameState:
    missing, most = moved.target_n - moved.force_n, moved.rate_n_s * dt_s
    change = max(-most, min(most, -missing * math.expm1(-dt_s / parameters.approach_time_s)))
    moved = replace(moved, extension_mm=moved.extension_mm + change / moved.stiffness_n_mm)
    if moved.force_n > moved.peak_n:  # the controller goes on until the force is there, whatever the specimen gives way
        plastic_mm = elongation_mm(moved.force_n)
        more_mm = plastic_mm - moved.plastic_mm
        moved = replace(moved, peak_n=moved.force_n, plastic_mm=plastic_mm, extension_mm=moved.extension_mm + more_mm)
    if moved.drive is Drive.RAMPING and abs(moved.target_n - moved.force_n) <= parameters.arrived_n:
        moved = replace(moved, drive=Drive.HOLDING, keeps_load=parameters.hold == "load")
    return moved


def _flowing(moved: LoadFrameState, elongation_mm: Callable[[float], float]) -> LoadFrameState:
    """At a given extension: the force at which load and plastic elongation agree, by bisection to 1e-9 of the highest force."""
    low, high = moved.peak_n, moved.force_n
    if high <= low or moved.broken:
        return moved
    for _ in range(30):
        middle = 0.5 * (low + high)
        flows = replace(moved, plastic_mm=elongation_mm(middle)).force_n > middle
        low, high = (middle, high) if flows else (low, middle)
    return replace(moved, peak_n=high, plastic_mm=elongation_mm(high))


def _stopped_by_switch(moved: LoadFrameState, before: LoadFrameState, parameters: LoadFrameParameters) -> LoadFrameState:
    outwards = moved.extension_mm - before.extension_mm
    low, high = parameters.extension_min_mm, parameters.extension_max_mm
    if (moved.extension_mm > high and outwards > 0) or (moved.extension_mm < low and outwards < 0):
        return with_fault(replace(moved, extension_mm=min(max(moved.extension_mm, low), high)), Drive.LIMIT)
    return moved


def _yielding(moved: LoadFrameState, parameters: LoadFrameParameters) -> LoadFrameState:
    if moved.force_n > parameters.slip_n and moved.slipped_mm == 0.0:
        moved = slip(moved, parameters.slip_mm)
    return fracture(moved) if moved.force_n > parameters.fracture_n else moved


def _overloaded(moved: LoadFrameState, parameters: LoadFrameParameters) -> LoadFrameState:
    beyond = abs(moved.force_n) > parameters.force_limit_n
    if beyond and moved.drive not in (Drive.OVERLOAD, Drive.EMERGENCY) and not _unloading(moved):
        return replace(moved, drive=Drive.OVERLOAD, keeps_load=False)
    return moved


def _unloading(state: LoadFrameState) -> bool:
    if state.drive is Drive.JOGGING:
        return state.jog_mm_s * state.force_n < 0
    return state.drive is Drive.RAMPING and abs(state.target_n) < abs(state.force_n)
