"""A load frame put together from several devices: the cell from one, the drive from another, a strain gage from a third."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict

from semlive.errors import BadConfig, LinkError, SemliveError
from semlive.ports import ClockSource
from semlive_drivers import csv_load_file
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings
from semlive_drivers.device_part import Part
from semlive_drivers.modbus import part as modbus
from semlive_drivers.modbus.settings import checked
from semlive_drivers.text import part as text

ROLES = ("cell", "drive", "gage", "watchdog")


class AssembledSettings(BaseModel):
    """The parts by role; each says its protocol and has the settings of that protocol's driver."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell: dict[str, Any] | None = None
    """Tells the load."""
    drive: dict[str, Any] | None = None
    """Moves."""
    gage: dict[str, Any] | None = None
    """Tells the strain of a gage on the specimen."""
    watchdog: dict[str, Any] | None = None
    """Is fed with every reading, and takes the drive's power away when it is not."""


Opener = Callable[[Mapping[str, object], ClockSource, str], Part]
_OPENERS: dict[str, Opener] = {"modbus": modbus.open_part, "ascii": text.open_part, "csv": csv_load_file.open_part}


def open_devices(given: Mapping[str, Mapping[str, object] | None], clock: ClockSource) -> list[Part]:
    """Open devices by role; those on one serial line share it.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if nobody, or somebody else, answers.
        LinkError: if a device answers nonsense.
    """
    parts: list[Part] = []
    try:
        for role, settings in given.items():
            if settings is None:
                continue
            protocol = settings.get("protocol", "modbus")
            if protocol not in _OPENERS:
                raise BadConfig(f"{role}: protocol {protocol!r} is not known; it may be {', '.join(_OPENERS)}")
            rest = {key: value for key, value in settings.items() if key != "protocol"}
            parts.append(_OPENERS[str(protocol)](rest, clock, role))
    except SemliveError:
        for part in parts:
            with contextlib.suppress(LinkError):
                part.close()
        raise
    return parts


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> CompositeLoadFrame:
    """Open all parts.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if nobody, or somebody else, answers.
        LinkError: if a device answers nonsense.
    """
    own, rest = FrameSettings.split(settings)
    known = checked(FrameSettings, own, "assembled load frame")
    given = checked(AssembledSettings, rest, "assembled load frame")
    parts = open_devices({role: getattr(given, role) for role in ROLES}, clock)
    try:
        return CompositeLoadFrame(parts, known, clock)
    except SemliveError:
        for part in parts:
            part.close()
        raise
