"""Codes of faults: one for each reason why a device was stopped or an alarm was raised."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class FaultCode(StrEnum):
    """The kind of a fault; stored as `code` in `/fault` messages, and only ever extended.

    First group: readings disagree with the ordered motion. Second group: the state of the device disagrees with the last command of
    semlive. Third group: faults reported by the device or its link. Fourth group: faults of semlive and the microscope.
    """

    NO_RESPONSE = "no_response"
    FROZEN_READING = "frozen_reading"
    SENSOR_RANGE = "sensor_range"
    OVERSHOOT = "overshoot"
    RATE_NOT_KEPT = "rate_not_kept"
    MOTION_OVERDUE = "motion_overdue"
    WRONG_DIRECTION = "wrong_direction"
    LOAD_JUMP = "load_jump"
    TRAVEL_WITHOUT_LOAD = "travel_without_load"
    LIMIT = "limit"
    NOT_REACHED = "not_reached"
    MOTION_TIMEOUT = "motion_timeout"
    STOPPED_EARLY = "stopped_early"

    UNORDERED_MOTION = "unordered_motion"
    MOVED_AT_REST = "moved_at_rest"
    FOREIGN_ORDER = "foreign_order"
    DEVICE_RESTARTED = "device_restarted"
    WOULD_UNLOAD = "would_unload"
    LOADED_AT_START = "loaded_at_start"

    STOP_NOT_OBEYED = "stop_not_obeyed"
    ORDER_REFUSED = "order_refused"
    LINK_LOST = "link_lost"
    DEVICE_FAULT = "device_fault"
    LIMIT_SWITCH = "limit_switch"
    EMERGENCY_STOP = "emergency_stop"

    CONTROL_LOST = "control_lost"
    INTERNAL_ERROR = "internal_error"
    FRAME_TIMEOUT = "frame_timeout"
    ANALYSIS = "analysis"
    LOG = "log"
    EXPORT_FOLDER = "export_folder"


class FaultKind(StrEnum):
    """Part of semlive or of the experiment that a fault concerns; stored as `kind` in `/fault` messages, and only ever extended.

    MODEL_WARNING is a warning about the model of a pair that was used; PAIR_UNUSABLE is a pair without result; POINTS_NOT_CALIBRATED is
    a frame with points outside the calibrated area, whose other points have a result. The other kinds name the component with the fault.
    """

    MODEL_WARNING = "model_warning"
    PAIR_UNUSABLE = "pair_unusable"
    POINTS_NOT_CALIBRATED = "points_not_calibrated"
    ANALYSIS = "analysis"
    LOG = "log"
    EXPORT_FOLDER = "export_folder"
    DEVICE = "device"
    RUN = "run"


RESULT_FAULTS = frozenset((FaultKind.MODEL_WARNING, FaultKind.PAIR_UNUSABLE, FaultKind.POINTS_NOT_CALIBRATED))
"""Faults of single results: the run continues, and the results are to be checked before they are used."""
MODEL_WARNING_ORIGIN = "estimate with pair "
"""Begin of `where` in a fault of kind MODEL_WARNING; the number of the pair follows."""
PAIR_ORIGIN = "analysis of pair "
"""Begin of `where` in a fault of kind PAIR_UNUSABLE or POINTS_NOT_CALIBRATED; the number of the pair follows."""
_KINDS: Mapping[str, FaultKind] = MappingProxyType(
    {
        "analysis": FaultKind.ANALYSIS,
        "log": FaultKind.LOG,
        "export folder": FaultKind.EXPORT_FOLDER,
        "load frame": FaultKind.DEVICE,
        "stage": FaultKind.DEVICE,
        "SEM": FaultKind.DEVICE,
        "run": FaultKind.RUN,
    }
)


def fault_kind(where: str) -> FaultKind | None:
    """Return the kind of a fault of a component, and of a fault in a log without kinds; None for other origins."""
    if where.startswith(MODEL_WARNING_ORIGIN):
        return FaultKind.MODEL_WARNING
    return FaultKind.PAIR_UNUSABLE if where.startswith(PAIR_ORIGIN) else _KINDS.get(where)
