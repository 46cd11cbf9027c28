"""Experiments as changes of a run's protocol, by the names that its configuration has."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from semlive.diagnose.experiments.proposals import ExperimentKind

PARKED_PAIRS = 10
LONGER = 4.0
# Moves of 32 px that end 0.3 px from where they should tell axes to 0.5 %, and an axis is 1 % off; what twelve of 150 px tell is in
# docs/how-to/diagnose.md. The order keeps drift, as a parabola, and backlash apart from the axes.
REACH_PX = 150.0
SQUARE = ((0, 0), (1, 1), (-1, 0), (0, -1), (-1, -1), (0, 1), (1, -1), (1, 0), (-1, 1), (1, 1), (-1, -1), (-1, 1), (1, -1))
Protocol = dict[str, Any]


def protocol_for(protocol: Protocol, kind: ExperimentKind) -> Protocol:
    """A protocol with an experiment in place of its own."""
    return {**protocol, **_CHANGES[kind](protocol)}


def within_travel(protocol: Protocol, travel_px: float) -> Protocol:
    """A protocol whose shifts are made smaller, all by one factor, where a stage may not go so far."""
    shifts = protocol.get("calibration_shifts_px") or []
    farthest = max((abs(float(value)) for shift in shifts for value in shift), default=0.0)
    by = travel_px / farthest if farthest > travel_px else 1.0
    return {**protocol, "calibration_shifts_px": [[round(by * float(value), 1) for value in shift] for shift in shifts]}


def _unloaded(shifts: list[Any]) -> Protocol:
    return {"calibration_shifts_px": shifts, "translation_shifts_px": [], "loads_n": [], "warm_up": None}


def square_px(reach_px: float) -> list[list[float]]:
    """Places on the edge of a square about the first one, so far along each axis."""
    return [[reach_px * x, reach_px * y] for x, y in SQUARE]


def _there_and_back(protocol: Protocol) -> Protocol:
    shifts = protocol.get("calibration_shifts_px") or []
    return _unloaded([value for shift in shifts for value in (shift, [0.0, 0.0])])


_CHANGES: dict[ExperimentKind, Callable[[Protocol], Protocol]] = {
    ExperimentKind.STATIONARY_SERIES: lambda protocol: _unloaded([[0.0, 0.0]] * PARKED_PAIRS),
    ExperimentKind.REPEAT: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
    ExperimentKind.LONGER_HOLD: lambda protocol: {"hold_s": LONGER * float(protocol.get("hold_s", 30.0)), "adaptive_hold": None},
    ExperimentKind.ZERO_LOAD_STEPS: lambda protocol: {"loads_n": [load for load in protocol.get("loads_n") or [] for _ in range(2)]},
    ExperimentKind.UNLOAD: lambda protocol: {
        "loads_n": [*(protocol.get("loads_n") or []), *reversed((protocol.get("loads_n") or [])[:-1])]
    },
    ExperimentKind.REVERSED: _there_and_back,
    ExperimentKind.CHANGED_SCAN_TIMES: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
    ExperimentKind.ROTATED_SCAN: lambda _: _unloaded(square_px(REACH_PX)) | {"recentre_beyond_px": None},
}
