"""Faults of the load frame and of the lines to it, planned by a scenario or ordered during a run."""

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
    """Kind of a fault of the load train."""

    EMERGENCY_STOP = "emergency_stop"
    LIMIT_SWITCH = "limit_switch"
    GRIP_SLIP = "grip_slip"
    FRACTURE = "fracture"
    STAGE_STALL = "stage_stall"
    FROZEN_READINGS = "frozen_readings"
    GAGE_OFF = "gage_off"


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A fault of the load train at an instant, or of a line for some time.

    Attributes:
        at_s: start, seconds since the run began.
        what: kind of the fault.
        lasts_s: duration of a pressed emergency stop, of frozen readings, of a disconnected gage, or of corrupted replies, s.
        slip_mm: slip of the grips, mm.
        line: faulty line; None for all lines.
        wait_s: delay of a reply, or time between its pieces, wall time, s.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    at_s: float
    what: MachineFault | LineFault
    lasts_s: float = 0.0
    slip_mm: float = 0.0
    line: Line | None = None
    wait_s: float = 0.05

    def occurs_between(self, before_s: float, now_s: float) -> bool:
        """Whether the fault starts between two instants, seconds since the run began."""
        return before_s < self.at_s <= now_s

    def lasts(self, now_s: float) -> bool:
        """Whether the fault is active at an instant, seconds since the run began."""
        return self.at_s <= now_s < self.at_s + self.lasts_s


class FaultSchedule:
    """Faults of the scenario and faults ordered during the run; thread-safe."""

    def __init__(self, planned: Iterable[PlannedFault]) -> None:
        self._planned = tuple(planned)
        self._lock = threading.Lock()
        self._waiting: list[PlannedFault] = []
        self._ordered: list[PlannedFault] = []

    def order(self, what: MachineFault, lasts_s: float = 0.0, slip_mm: float = 0.0) -> None:
        """Order a fault for the next step of the machine."""
        with self._lock:
            self._waiting.append(PlannedFault(0.0, what, lasts_s, slip_mm))

    def clear(self) -> None:
        """Remove all ordered faults; active ones end."""
        with self._lock:
            self._waiting.clear()
            self._ordered.clear()

    def active_and_planned(self) -> tuple[PlannedFault, ...]:
        """All planned faults, and all ordered faults that have started."""
        with self._lock:
            return (*self._planned, *self._ordered)

    def start_ordered(self, now_s: float) -> tuple[PlannedFault, ...]:
        """As `active_and_planned`, after waiting faults have been started at `now_s`, the end of a step."""
        with self._lock:
            self._ordered += [replace(fault, at_s=now_s) for fault in self._waiting]
            self._waiting.clear()
            return (*self._planned, *self._ordered)


def apply_faults(state: LoadFrameState, faults: Iterable[PlannedFault], before_s: float, now_s: float) -> LoadFrameState:
    """The machine after the faults between two instants, seconds since the run began.

    A pressed emergency stop stays active for its duration, also after orders.
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


def planned_line_faults(faults: Iterable[PlannedFault]) -> tuple[PlannedLineFault, ...]:
    """The faults of the lines in a list of faults."""
    return tuple(
        PlannedLineFault(fault.at_s, fault.lasts_s, fault.line, ReplyFault(fault.what, fault.wait_s))
        for fault in faults
        if isinstance(fault.what, LineFault)
    )
