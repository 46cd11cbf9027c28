"""Trigger `sharksem`: a TESCAN microscope scans one frame on request."""

from __future__ import annotations

import itertools
from typing import Literal

from pydantic import Field

from semlive.ports import ClockSource
from semlive_drivers.endpoint_lock import reserve_tcp
from semlive_drivers.microscope.driver import MicroscopeDriver
from semlive_drivers.microscope.sharksem.connection import Connection
from semlive_drivers.microscope.sharksem.session import ScanRequest, SharkSemSession
from semlive_drivers.microscope.trigger import MicroscopeSettings, MicroscopeTrigger


class SharkSemSettings(MicroscopeSettings):
    """Settings of the trigger `sharksem`."""

    host: str
    port: int = Field(default=8300, ge=1, le=65_534)
    """TCP port of commands; image data use the next one."""
    width_px: int = Field(default=1024, ge=16, le=16_384)
    """Columns of a frame."""
    height_px: int = Field(default=1024, ge=16, le=16_384)
    """Rows of a frame."""
    dwell_time_us: float | None = Field(default=None, gt=0, le=1e6)
    """Time on a pixel, us; without it, that of the scan speed which is set at the microscope."""
    channel: int = Field(default=0, ge=0, le=7)
    """Video channel; its detector is the one that is selected at the microscope."""
    bits: Literal[8, 16] = 8
    """Bits per pixel."""
    resume_live: bool = True
    """Start the live image again after a scan if it was running before."""
    answer_timeout_s: float = Field(default=5.0, gt=0, le=60)
    """Longest time for the answer to a command, and without image data during a scan, s."""


def _trigger(config: SharkSemSettings, clock: ClockSource) -> MicroscopeTrigger:
    endpoint = reserve_tcp(config.host, config.port)
    scan_request = ScanRequest(config.width_px, config.height_px, config.channel, config.bits, config.dwell_time_us, config.resume_live)
    frames = itertools.count(1)

    def session() -> SharkSemSession:
        connection = Connection(config.host, config.port, config.answer_timeout_s)
        try:
            return SharkSemSession(connection, scan_request, clock, next(frames), config.frame_timeout_s)
        except BaseException:
            connection.close()
            raise

    return MicroscopeTrigger(session, config, f"SharkSEM at {config.host}:{config.port}", endpoint.release)


_DRIVER = MicroscopeDriver("sharksem trigger", SharkSemSettings, _trigger)
open_trigger, check_device = _DRIVER.open_trigger, _DRIVER.check_device
