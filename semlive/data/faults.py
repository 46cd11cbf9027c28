"""Codes of faults: one for each reason why a device was stopped or an alarm was raised."""

from __future__ import annotations

from enum import StrEnum


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
