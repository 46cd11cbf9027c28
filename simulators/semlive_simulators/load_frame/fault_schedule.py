"""Faults that a scenario plans for an instant, or somebody orders: what a machine, or the line to it, does when nobody asked for it."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import ConfigDict

from semlive_simulators.load_frame import dynamics
from semlive_simulators.load_frame.dynamics import Drive, LoadFrameState
from semlive_simulators.load_frame.line_faults import Line, LineFault, PlannedLineFault, ReplyFault


class MachineFault(StrEnum):
    """What happens."""

    EMERGENCY_STOP = "emergency_stop"
    LIMIT_SWITCH = "limit_switch"
    GRIP_SLIP = "grip_slip"
    FRACTURE = "fracture"
    STAGE_STALL = "stage_stall"
    FROZEN_READINGS = "frozen_readings"
    GAGE_OFF = "gage_off"


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A mishap at an instant, or trouble on a line for a while.

    Attributes:
        at_s: when, seconds since the run began.
        what: happens.
        lasts_s: how long the emergency stop stays pressed, readings stand still, the gage is off, or every reply is spoilt.
        slip_mm: how far the grips slip.
        line: in trouble; all of them if not given.
        wait_s: how late a reply is, or how long between its pieces, wall time.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    at_s: float
    what: MachineFault | LineFault
    lasts_s: float = 0.0
    slip_mm: float = 0.0
    line: Line | None = None
    wait_s: float = 0.05

    def occurs_between(self, before_s: float, now_s: float) -> bool:
        """Whether it comes between two instants."""
        return before_s < self.at_s <= now_s

    def lasts(self, now_s: float) -> bool:
        """Whether it is there at an instant."""
        return self.at_s <= now_s < self.at_s + self.lasts_s


class FaultSchedule:
    """What the scenario plans and what was ordered meanwhile; safe from any thread."""

    def __init__(self, planned: Iterable[PlannedFault]) -> None:
        self._planned = tuple(planned)
        self._lock = threading.Lock()
        self._waiting: list[PlannedFault] = []
        self._ordered: list[PlannedFault] = []

    def order(self, what: MachineFault, lasts_s: float = 0.0, slip_mm: float = 0.0) -> None:
        """Let something happen with the machine's next step."""
        with self._lock:
            self._waiting.append(PlannedFault(0.0, what, lasts_s, slip_mm))

    def clear(self) -> None:
        """Forget all orders: what was ordered to last is over."""
        with self._lock:
            self._waiting.clear()
            self._ordered.clear()

    def known(self) -> tuple[PlannedFault, ...]:
        """All that is planned and all that has been ordered and begun."""
        with self._lock:
            return (*self._planned, *self._ordered)

    def begun(self, now_s: float) -> tuple[PlannedFault, ...]:
        """The same for a step that ends at `now_s`, with which begins what was waiting."""
        with self._lock:
            self._ordered += [replace(fault, at_s=now_s) for fault in self._waiting]
            self._waiting.clear()
            return (*self._planned, *self._ordered)


def apply_faults(state: LoadFrameState, faults: Iterable[PlannedFault], before_s: float, now_s: float) -> LoadFrameState:
    """The machine after what was planned for the time between two instants.

    A pressed emergency stop holds as long as it lasts, whatever is ordered meanwhile.
    """
    for fault in faults:
        if fault.what is MachineFault.EMERGENCY_STOP and fault.at_s <= now_s and before_s < fault.at_s + fault.lasts_s:
            state = dynamics.with_fault(state, Drive.EMERGENCY)
        if isinstance(fault.what, LineFault) or not fault.occurs_between(before_s, now_s):
            continue
        if fault.what is MachineFault.EMERGENCY_STOP:
            state = dynamics.with_fault(state, Drive.EMERGENCY)
        elif fault.what is MachineFault.LIMIT_SWITCH:
            state = dynamics.with_fault(state, Drive.LIMIT)
        elif fault.what is MachineFault.GRIP_SLIP:
            state = dynamics.slip(state, fault.slip_mm)
        elif fault.what is MachineFault.FRACTURE:
            state = dynamics.fracture(state)
    return state


def troubles(faults: Iterable[PlannedFault]) -> tuple[PlannedLineFault, ...]:
    """What is planned for the lines."""
    return tuple(
        PlannedLineFault(fault.at_s, fault.lasts_s, fault.line, ReplyFault(fault.what, fault.wait_s))
        for fault in faults
        if isinstance(fault.what, LineFault)
    )
