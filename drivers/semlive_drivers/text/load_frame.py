"""A load frame that speaks text over a serial line, described by one dialogue."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.errors import SemliveError
from semlive.ports import ClockSource
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings
from semlive_drivers.modbus.settings import checked
from semlive_drivers.text.part import open_part


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> CompositeLoadFrame:
    """Open the line and check who answers.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if the line cannot be opened, or somebody else answers.
        LinkError: if the device answers nonsense.
    """
    own, rest = FrameSettings.split(settings)
    known = checked(FrameSettings, own, "ascii load frame")
    part = open_part(rest, clock)
    try:
        return CompositeLoadFrame([part], known, clock)
    except SemliveError:
        part.close()
        raise
