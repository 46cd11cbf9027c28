"""A load frame that is controlled by text on a serial line, described by one dialogue."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.ports import ClockSource
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings, compose
from semlive_drivers.settings import checked
from semlive_drivers.text.part import open_part


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> CompositeLoadFrame:
    """Open the line and check the identity of the device.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if the line cannot be opened, or another device answers.
        LinkError: if an answer is not valid.
    """
    frame_keys, part_keys = FrameSettings.split(settings)
    frame_settings = checked(FrameSettings, frame_keys, "ascii load frame")
    return compose([open_part(part_keys, clock)], frame_settings, clock)
