"""`semlive frame check`: looks at a device without moving it; the entry point of ``semlive.frame_checks``."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.data.frame_check import FrameCheck
from semlive.errors import BadConfig
from semlive.ports import ClockSource
from semlive_drivers.maps import map_content
from semlive_drivers.modbus.check import check_modbus
from semlive_drivers.text.check import check_text


def check_frame(name: str, settings: Mapping[str, object], clock: ClockSource) -> FrameCheck:
    """Look at the device that a description describes.

    Raises:
        BadConfig: for settings or a description that are not understood.
        LinkRefused: if nobody answers.
        LinkError: if the link is lost meanwhile.
    """
    if map_content(name)["protocol"] == "modbus":
        return check_modbus(name, settings)
    if "serial" not in settings:
        raise BadConfig(f"{name} speaks over a serial line; give its path: --port /dev/ttyUSB0")
    return check_text(name, {key: value for key, value in settings.items() if key != "unit"}, clock)
