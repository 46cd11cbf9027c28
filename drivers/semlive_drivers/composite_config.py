"""A load frame of several devices, such as load cell, drive, strain gage and watchdog."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict

from semlive.data.checks import Finding
from semlive.errors import BadConfig, LinkError, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings, compose
from semlive_drivers.device_part import Part
from semlive_drivers.load_file import part as csv_load_file
from semlive_drivers.load_file.check import check_load_file
from semlive_drivers.modbus import part as modbus
from semlive_drivers.settings import checked
from semlive_drivers.text import part as text

ROLES = ("cell", "drive", "gage", "watchdog")


class AssembledSettings(BaseModel):
    """The parts by role; each states its protocol and has the settings of the driver of that protocol."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell: dict[str, Any] | None = None
    """Device that measures the load."""
    drive: dict[str, Any] | None = None
    """Device that moves the crosshead."""
    gage: dict[str, Any] | None = None
    """Device that measures the strain of a gage on the specimen."""
    watchdog: dict[str, Any] | None = None
    """Device that receives a heartbeat with every reading, and switches off the drive without it."""


Opener = Callable[[Mapping[str, object], ClockSource, str], Part]
_OPENERS: dict[str, Opener] = {"modbus": modbus.open_part, "ascii": text.open_part, "csv": csv_load_file.open_part}


def open_devices(configured: Mapping[str, Mapping[str, object] | None], clock: ClockSource) -> list[Part]:
    """Open the devices of the roles; devices on one serial line share it.

    Args:
        configured: settings by role; None for a role without a device.
        clock: experiment time.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if no device, or another one, answers.
        LinkError: if an answer is not valid.
    """
    parts: list[Part] = []
    try:
        for role, settings in configured.items():
            if settings is None:
                continue
            protocol = settings.get("protocol", "modbus")
            if protocol not in _OPENERS:
                raise BadConfig(f"{role}: protocol {protocol!r} is not known; it may be {', '.join(_OPENERS)}")
            part_keys = {key: value for key, value in settings.items() if key != "protocol"}
            parts.append(_OPENERS[str(protocol)](part_keys, clock, role))
    except SemliveError:
        for part in parts:
            with contextlib.suppress(LinkError):
                part.close()
        raise
    return parts


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> CompositeLoadFrame:
    """Open all parts of a load frame.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if no device, or another one, answers.
        LinkError: if an answer is not valid.
    """
    frame_keys, part_keys = FrameSettings.split(settings)
    frame_settings = checked(FrameSettings, frame_keys, "assembled load frame")
    roles = checked(AssembledSettings, part_keys, "assembled load frame")
    return compose(open_devices({role: getattr(roles, role) for role in ROLES}, clock), frame_settings, clock)


def check_files(settings: Mapping[str, object], clock: ClockSource) -> list[Finding]:
    """Read the newest line of each part that is a file, as a run would.

    Raises:
        BadConfig: for settings that are not valid.
    """
    roles = checked(AssembledSettings, FrameSettings.split(settings)[1], "assembled load frame")
    parts = {role: dict(part) for role in ROLES if (part := getattr(roles, role)) is not None and part.get("protocol") == "csv"}
    for part in parts.values():
        del part["protocol"]
    return [check_load_file(role, checked(csv_load_file.CsvSettings, part, role), clock) for role, part in parts.items()]
