"""Faults that a scenario plans for an instant: what a machine, or the line to it, does when nobody asked for it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from pydantic import ConfigDict

from semlive_simulators.load_frame import dynamics
from semlive_simulators.load_frame.dynamics import Drive, LoadFrameState
from semlive_simulators.load_frame.trouble import Line, PlannedTrouble, Spoiling, Trouble


class Mishap(StrEnum):
    """What happens."""

    EMERGENCY_STOP = "emergency_stop"
    LIMIT_SWITCH = "limit_switch"
    GRIP_SLIP = "grip_slip"
    FRACTURE = "fracture"


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A mishap at an instant, or trouble on a line for a while.

    Attributes:
        at_s: when, seconds since the run began.
        what: happens.
        lasts_s: how long the emergency stop stays pressed, or every reply is spoilt.
        slip_mm: how far the grips slip.
        line: in trouble; all of them if not given.
        wait_s: how late a reply is, or how long between its pieces, wall time.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    at_s: float
    what: Mishap | Trouble
    lasts_s: float = 0.0
    slip_mm: float = 0.0
    line: Line | None = None
    wait_s: float = 0.05


def struck(state: LoadFrameState, faults: Iterable[PlannedFault], before_s: float, now_s: float) -> LoadFrameState:
    """The machine after what was planned for the time between two instants.

    A pressed emergency stop holds as long as it lasts, whatever is ordered meanwhile.
    """
    for fault in faults:
        if fault.what is Mishap.EMERGENCY_STOP and fault.at_s <= now_s and before_s < fault.at_s + fault.lasts_s:
            state = dynamics.tripped(state, Drive.EMERGENCY)
        if isinstance(fault.what, Trouble) or not before_s < fault.at_s <= now_s:
            continue
        if fault.what is Mishap.EMERGENCY_STOP:
            state = dynamics.tripped(state, Drive.EMERGENCY)
        elif fault.what is Mishap.LIMIT_SWITCH:
            state = dynamics.tripped(state, Drive.LIMIT)
        elif fault.what is Mishap.GRIP_SLIP:
            state = dynamics.slip(state, fault.slip_mm)
        else:
            state = dynamics.fracture(state)
    return state


def troubles(faults: Iterable[PlannedFault]) -> tuple[PlannedTrouble, ...]:
    """What is planned for the lines."""
    return tuple(
        PlannedTrouble(fault.at_s, fault.lasts_s, fault.line, Spoiling(fault.what, fault.wait_s))
        for fault in faults
        if isinstance(fault.what, Trouble)
    )
