"""Motion of the load frame: pure functions of a state and a duration of experiment time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

from pydantic import ConfigDict


@dataclass(frozen=True, slots=True)
class LoadFrameParameters:
    """Parameters of the load frame.

    Attributes:
        machine_stiffness_n_mm: stiffness of all parts in series with the specimen, N/mm.
        approach_time_s: time constant of the last part of a ramp, s.
        arrived_n: distance from the target at which a ramp ends, N.
        relaxation_fraction: fraction of the load that relaxes at constant position.
        relaxation_time_s: time constant of the relaxation, s.
        force_limit_n: force beyond which the machine stops with a fault, N.
        cell_noise_n: standard deviation of one reading of the load cell, N.
        extension_noise_mm: standard deviation of one reading of the crosshead, mm.
        extension_min_mm: extension of the lower limit switch, mm.
        extension_max_mm: extension of the upper limit switch, mm.
        slip_n: force at which the grips slip the first time, N.
        slip_mm: slip of the grips, mm.
        fracture_n: force beyond which the specimen breaks, N.
        cell_resolution_n: step of the readings of the load cell, N; 0 for none.
        hold: quantity that is held after a ramp: the ``position``, so that the load relaxes, or the ``load``, so that the crosshead creeps.
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
        """A force rounded to the resolution of the load cell, N."""
        return self.cell_resolution_n * round(force_n / self.cell_resolution_n) if self.cell_resolution_n else force_n


class Drive(StrEnum):
    """State of the drive; some states are faults."""

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
        drive: state of the drive.
        target_n: target of the last ramp, N.
        rate_n_s: rate of the last ramp, N/s.
        jog_mm_s: crosshead speed in displacement control, mm/s, tension positive.
        jog_to_mm: extension at which that motion ends, mm.
        keeps_load: whether load control is active during a hold.
        stiffness_n_mm: stiffness of machine and specimen in series, N/mm.
        extension_mm: extension of the crosshead, mm.
        relaxed_n: load lost by relaxation so far, N.
        slipped_mm: slip of the grips so far, mm.
        broken: whether the specimen is broken.
        peak_n: highest force so far, N.
        plastic_mm: permanent elongation of the specimen, mm.
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
        """True force on the specimen, N."""
        return 0.0 if self.broken else self.elastic_n - self.relaxed_n

    @property
    def elastic_n(self) -> float:
        """The force without relaxation, N."""
        return self.stiffness_n_mm * (self.extension_mm - self.slipped_mm - self.plastic_mm)

    @property
    def moving(self) -> bool:
        """Whether the crosshead is driven."""
        return self.drive in (Drive.RAMPING, Drive.JOGGING)

    @property
    def faulty(self) -> bool:
        """Whether the drive stopped with a fault."""
        return self.drive in FAULTS


def at_rest(parameters: LoadFrameParameters, specimen_stiffness_n_mm: float) -> LoadFrameState:
    """An unloaded machine with a specimen in its grips."""
    return LoadFrameState(1.0 / (1.0 / specimen_stiffness_n_mm + 1.0 / parameters.machine_stiffness_n_mm))


def ramp_to(state: LoadFrameState, target_n: float, rate_n_s: float) -> LoadFrameState:
    """Start a ramp in load control; also acknowledges a watchdog fault."""
    return replace(state, drive=Drive.RAMPING, target_n=target_n, rate_n_s=rate_n_s, keeps_load=False)


def jog(state: LoadFrameState, speed_mm_s: float) -> LoadFrameState:
    """Start a motion in displacement control, tension positive; also acknowledges a watchdog fault."""
    return replace(state, drive=Drive.JOGGING, jog_mm_s=speed_mm_s, jog_to_mm=math.copysign(math.inf, speed_mm_s), keeps_load=False)


def travel_to(state: LoadFrameState, extension_mm: float, speed_mm_s: float) -> LoadFrameState:
    """Start a motion to an extension in displacement control, then hold it; also acknowledges a watchdog fault."""
    return replace(jog(state, math.copysign(speed_mm_s, extension_mm - state.extension_mm)), jog_to_mm=extension_mm)


def stop(state: LoadFrameState) -> LoadFrameState:
    """Stop and hold position; also acknowledges a fault. The target becomes the present load."""
    return replace(state, drive=Drive.HOLDING, target_n=state.force_n, keeps_load=False)


def trip_watchdog(state: LoadFrameState) -> LoadFrameState:
    """The state after the watchdog expired: stopped with a fault, unless there is one already."""
    return state if state.faulty else with_fault(state, Drive.WATCHDOG)


def with_fault(state: LoadFrameState, fault: Drive) -> LoadFrameState:
    """The state after a fault: the drive holds its position."""
    return replace(state, drive=fault, target_n=state.force_n, keeps_load=False)


def slip(state: LoadFrameState, slip_mm: float) -> LoadFrameState:
    """The state after the grips slipped, mm."""
    return replace(state, slipped_mm=state.slipped_mm + slip_mm)


def fracture(state: LoadFrameState) -> LoadFrameState:
    """The state after the specimen broke, which the machine does not detect."""
    return replace(state, broken=True)


def elastic(peak_n: float) -> float:
    """The permanent elongation of an elastic specimen: 0."""
    return 0.0 * peak_n


def step(
    state: LoadFrameState, parameters: LoadFrameParameters, dt_s: float, elongation_mm: Callable[[float], float] = elastic
) -> LoadFrameState:
    """The machine after a time step.

    Args:
        state: state before the step.
        parameters: parameters of the machine.
        dt_s: duration of the step, experiment time, s.
        elongation_mm: permanent elongation of the specimen, mm, after a highest force, N; must not decrease.

    A ramp runs at its rate and approaches the target exponentially. Grips and machine creep: at constant position the load decreases, and
    load control moves the crosshead instead. With a broken specimen, load control moves the crosshead to the limit switch.
    """
    lost = parameters.relaxation_fraction * state.elastic_n
    relaxed = lost + (state.relaxed_n - lost) * math.exp(-dt_s / parameters.relaxation_time_s)
    moved = state if relaxed == state.relaxed_n else replace(state, relaxed_n=relaxed)
    if state.drive is Drive.RAMPING or state.keeps_load:
        moved = _load_controlled(moved, parameters, dt_s, elongation_mm)
    elif state.drive is Drive.JOGGING:
        travel_mm = state.jog_mm_s * dt_s
        reached = abs(state.jog_to_mm - state.extension_mm) <= abs(travel_mm)
        moved = replace(moved, extension_mm=state.jog_to_mm if reached else state.extension_mm + travel_mm)
        moved = stop(moved) if reached else moved
    deformed = _with_plastic_flow(_stopped_by_switch(moved, state, parameters), elongation_mm)
    return _with_overload(_with_slip_or_fracture(deformed, parameters), parameters)


def _load_controlled(
    moved: LoadFrameState, parameters: LoadFrameParameters, dt_s: float, elongation_mm: Callable[[float], float]
) -> LoadFrameState:
    missing_n, max_change_n = moved.target_n - moved.force_n, moved.rate_n_s * dt_s
    change_n = max(-max_change_n, min(max_change_n, -missing_n * math.expm1(-dt_s / parameters.approach_time_s)))
    moved = replace(moved, extension_mm=moved.extension_mm + change_n / moved.stiffness_n_mm)
    if moved.force_n > moved.peak_n:  # the controller compensates plastic elongation within the step
        plastic_mm = elongation_mm(moved.force_n)
        growth_mm = plastic_mm - moved.plastic_mm
        moved = replace(moved, peak_n=moved.force_n, plastic_mm=plastic_mm, extension_mm=moved.extension_mm + growth_mm)
    if moved.drive is Drive.RAMPING and abs(moved.target_n - moved.force_n) <= parameters.arrived_n:
        moved = replace(moved, drive=Drive.HOLDING, keeps_load=parameters.hold == "load")
    return moved


def _with_plastic_flow(moved: LoadFrameState, elongation_mm: Callable[[float], float]) -> LoadFrameState:
    """The state at a fixed extension with consistent load and plastic elongation, by bisection to 1e-9 of the highest force."""
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


def _with_slip_or_fracture(moved: LoadFrameState, parameters: LoadFrameParameters) -> LoadFrameState:
    if moved.force_n > parameters.slip_n and moved.slipped_mm == 0.0:
        moved = slip(moved, parameters.slip_mm)
    return fracture(moved) if moved.force_n > parameters.fracture_n else moved


def _with_overload(moved: LoadFrameState, parameters: LoadFrameParameters) -> LoadFrameState:
    beyond = abs(moved.force_n) > parameters.force_limit_n
    if beyond and moved.drive not in (Drive.OVERLOAD, Drive.EMERGENCY) and not _unloading(moved):
        return replace(moved, drive=Drive.OVERLOAD, keeps_load=False)
    return moved


def _unloading(state: LoadFrameState) -> bool:
    if state.drive is Drive.JOGGING:
        return state.jog_mm_s * state.force_n < 0
    return state.drive is Drive.RAMPING and abs(state.target_n) < abs(state.force_n)
