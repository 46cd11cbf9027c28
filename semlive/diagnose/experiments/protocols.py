"""Experiments as changes of the protocol section of a run's configuration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from semlive.diagnose.experiments.proposals import ExperimentKind

STATIONARY_PAIRS = 10
HOLD_RATIO = 4.0
# Moves of 32 px with position errors of 0.3 px determine the scan axes to 0.5 %, and typical errors are 1 %. docs/how-to/diagnose.md states
# the uncertainty for twelve moves of 150 px. The order makes the axes independent of backlash and of a drift that is a parabola in time.
SQUARE_HALF_WIDTH_PX = 150.0
SQUARE_SHIFTS = ((0, 0), (1, 1), (-1, 0), (0, -1), (-1, -1), (0, 1), (1, -1), (1, 0), (-1, 1), (1, 1), (-1, -1), (-1, 1), (1, -1))
Protocol = dict[str, Any]


def protocol_for(protocol: Protocol, kind: ExperimentKind) -> Protocol:
    """The protocol with the changes for an experiment."""
    return {**protocol, **_PROTOCOL_CHANGES[kind](protocol)}


def within_travel(protocol: Protocol, travel_px: float) -> Protocol:
    """The protocol with shifts scaled by a common factor to the allowed travel of the stage, px."""
    shifts = protocol.get("calibration_shifts_px") or []
    farthest = max((abs(float(value)) for shift in shifts for value in shift), default=0.0)
    scale = travel_px / farthest if farthest > travel_px else 1.0
    return {**protocol, "calibration_shifts_px": [[round(scale * float(value), 1) for value in shift] for shift in shifts]}


def _unloaded(shifts: list[Any]) -> Protocol:
    return {"calibration_shifts_px": shifts, "translation_shifts_px": [], "loads_n": [], "warm_up": None}


def square_px(half_width_px: float) -> list[list[float]]:
    """Shifts, px, to points on the edge of a square of the given half width about the first position."""
    return [[half_width_px * x, half_width_px * y] for x, y in SQUARE_SHIFTS]


def _there_and_back(protocol: Protocol) -> Protocol:
    shifts = protocol.get("calibration_shifts_px") or []
    return _unloaded([value for shift in shifts for value in (shift, [0.0, 0.0])])


_PROTOCOL_CHANGES: dict[ExperimentKind, Callable[[Protocol], Protocol]] = {
    ExperimentKind.STATIONARY_SERIES: lambda protocol: _unloaded([[0.0, 0.0]] * STATIONARY_PAIRS),
    ExperimentKind.REPEAT: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
    ExperimentKind.LONGER_HOLD: lambda protocol: {"hold_s": HOLD_RATIO * float(protocol.get("hold_s", 30.0)), "adaptive_hold": None},
    ExperimentKind.ZERO_LOAD_STEPS: lambda protocol: {"loads_n": [load for load in protocol.get("loads_n") or [] for _ in range(2)]},
    ExperimentKind.UNLOAD: lambda protocol: {
        "loads_n": [*(protocol.get("loads_n") or []), *reversed((protocol.get("loads_n") or [])[:-1])]
    },
    ExperimentKind.REVERSED: _there_and_back,
    ExperimentKind.CHANGED_SCAN_TIMES: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
    ExperimentKind.CHANGED_PIXEL_SIZE: lambda protocol: _unloaded(protocol.get("calibration_shifts_px") or []),
    ExperimentKind.ROTATED_SCAN: lambda _: _unloaded(square_px(SQUARE_HALF_WIDTH_PX)) | {"recentre_beyond_px": None},
}
