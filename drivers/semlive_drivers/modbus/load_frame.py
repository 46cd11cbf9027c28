"""A load frame behind Modbus TCP or RTU, described by one register map."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.ports import ClockSource
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings, compose
from semlive_drivers.modbus.part import open_part
from semlive_drivers.settings import checked


def open_load_frame(settings: Mapping[str, object], clock: ClockSource) -> CompositeLoadFrame:
    """Open the link and check the identity of the device.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if no device, or another one, answers.
        LinkError: if an answer is not valid.
    """
    frame_keys, part_keys = FrameSettings.split(settings)
    frame_settings = checked(FrameSettings, frame_keys, "modbus load frame")
    return compose([open_part(part_keys, clock)], frame_settings, clock)
