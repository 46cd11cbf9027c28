"""A load frame behind Modbus TCP or RTU, described by one register map."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.errors import SemliveError
from semlive.ports import ClockSource
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings
from semlive_drivers.modbus.part import open_part
from semlive_drivers.modbus.settings import checked


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> CompositeLoadFrame:
    """Open the link and check who answers.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if nobody, or somebody else, answers.
        LinkError: if the device answers nonsense.
    """
    own, rest = FrameSettings.split(settings)
    known = checked(FrameSettings, own, "modbus load frame")
    part = open_part(rest, clock)
    try:
        return CompositeLoadFrame([part], known, clock)
    except SemliveError:
        part.close()
        raise
