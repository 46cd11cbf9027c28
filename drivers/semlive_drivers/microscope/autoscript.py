"""Trigger `autoscript`: a microscope of Thermo Fisher scans one frame on request, through the client of AutoScript.

The package ``autoscript_sdb_microscope_client`` is part of a licensed AutoScript installation; there is none on PyPI. It may run on any
computer of the microscope's network; the server runs on the microscope's computer.

Source: the reference manual of AutoScript, as published in `Hplentz/SharkSEM-Test-D`; `fibsem-os/fibsem-os` uses the same names. Facts:

- ``SdbMicroscopeClient().connect(host[, port])``, ``disconnect()``; the microscope's computer is 192.168.0.1 by default.
- ``beams.electron_beam``: ``is_on``, ``is_blanked``, ``horizontal_field_width.value`` (m), ``scanning.dwell_time.value`` (s),
  ``scanning.resolution.value`` (``1536x1024``), ``scanning.rotation.value`` (rad), ``scanning.mode.value`` (1: full frame),
  ``angular_correction.tilt_correction.is_on``, ``angular_correction.dynamic_focus.is_on``.
- ``imaging.get_active_device()`` (1: electron beam); ``imaging.grab_frame()`` scans a new frame in the active view with the current
  resolution and dwell time, 8 bit, without integration, and returns when it is complete; ``GrabFrameSettings(bit_depth=16)`` changes the
  depth.
- The image has ``width``, ``height``, ``save(path)`` (TIFF), and ``metadata.scan_settings`` with ``dwell_time`` and ``line_time``.

The row time is known after the scan only, from the image. Unconfirmed: that ``line_time`` is the row time with fly-back, in s; that
``save`` writes the tag that Thermo Fisher's own export writes, from which semlive reads times and pixel size; the values at a dual-beam
microscope whose active view changes. Stage, column and detector are never commanded.
"""

from __future__ import annotations

import contextlib
import importlib
import re
from typing import Any, Literal

from pydantic import Field

from semlive.data.scan_report import ScanReading
from semlive.errors import LinkError, LinkRefused
from semlive.ports import ClockSource
from semlive_drivers.microscope.driver import MicroscopeDriver
from semlive_drivers.microscope.frame_files import PendingFrame
from semlive_drivers.microscope.trigger import MicroscopeSettings, MicroscopeTrigger

_CLIENT = "autoscript_sdb_microscope_client"
_ELECTRON_BEAM = 1
_FULL_FRAME = 1
_RESOLUTION = re.compile(r"([0-9]{2,5})\s*[xX]\s*([0-9]{2,5})")
_RELATIVE_TOLERANCE = 1e-4


class AutoScriptSettings(MicroscopeSettings):
    """Settings of the trigger `autoscript`."""

    host: str = "192.168.0.1"
    port: int | None = Field(default=None, ge=1, le=65_535)
    """TCP port of the AutoScript server; without it, that of the client."""
    bits: Literal[8, 16] = 8
    """Bits per pixel."""


class AutoScriptSession:
    """The Session of `semlive_drivers.microscope.trigger` over an AutoScript client.

    Args:
        settings: validated settings.
        clock: experiment time.

    Raises:
        LinkRefused: the client is not installed, or no server answers.
    """

    def __init__(self, settings: AutoScriptSettings, clock: ClockSource) -> None:
        self._settings, self._clock = settings, clock
        try:
            self._microscope: Any = importlib.import_module(_CLIENT).SdbMicroscopeClient()
        except ImportError as error:
            raise LinkRefused(f"AutoScript: the package {_CLIENT} is missing; run semlive with the Python of AutoScript") from error
        address = (settings.host,) if settings.port is None else (settings.host, settings.port)
        try:
            self._microscope.connect(*address)
        except Exception as error:
            raise LinkRefused(
                f"AutoScript at {settings.host}: no answer ({error}); start the server, check address and firewall"
            ) from error
        self.name = f"Thermo Fisher microscope at {settings.host}"
        self._row_time_s: float | None = None

    def read(self) -> ScanReading:
        """Read the settings of the scan; changes nothing.

        Raises:
            LinkError: the beam is off or blanked, the active view shows another device, the mode is not full frame, or a value is wrong.
        """
        beam = self._microscope.beams.electron_beam
        if not beam.is_on:
            raise LinkError(f"{self.name}: its electron beam is off; switch it on, then resume")
        if beam.is_blanked:
            raise LinkError(f"{self.name}: its electron beam is blanked; unblank it, then resume")
        if self._microscope.imaging.get_active_device() != _ELECTRON_BEAM:
            raise LinkError(
                f"{self.name}: its active view does not show the electron beam; select the quad of the electron beam, then resume"
            )
        scanning, correction = beam.scanning, beam.angular_correction
        if scanning.mode.value != _FULL_FRAME:
            raise LinkError(f"{self.name}: its scan is not the full frame (mode {scanning.mode.value}); select full frame, then resume")
        size = _RESOLUTION.fullmatch(str(scanning.resolution.value).strip())
        dwell_s, field_m = float(scanning.dwell_time.value), float(beam.horizontal_field_width.value)
        if size is None or not dwell_s > 0 or not field_m > 0:
            raise LinkError(
                f"{self.name} reports {scanning.resolution.value!r}, a dwell time of {dwell_s:g} s and a field of {field_m:g} m"
            )
        others = (
            ("rotation", f"{float(scanning.rotation.value):.6g} rad"),
            ("tilt correction", "on" if correction.tilt_correction.is_on else "off"),
            ("dynamic focus", "on" if correction.dynamic_focus.is_on else "off"),
        )
        return ScanReading(self._clock.now_ns(), dwell_s, self._row_time_s, field_m, int(size[1]), int(size[2]), others)

    def scan(self, before: ScanReading, frame: PendingFrame) -> tuple[int, float | None]:
        """Scan one frame and write it; returns the end of the scan (experiment time, ns), and no measured row time.

        Raises:
            LinkError: the image has another size or dwell time than the settings before the scan, or is not written.
        """
        grab = self._microscope.imaging.grab_frame
        if self._settings.bits == 8:
            image = grab()
        else:
            image = grab(importlib.import_module(f"{_CLIENT}.structures").GrabFrameSettings(bit_depth=self._settings.bits))
        end_ns = self._clock.now_ns()
        if (image.width, image.height) != (before.width_px, before.height_px):
            sizes = f"{image.width} x {image.height} px instead of {before.width_px} x {before.height_px}"
            raise LinkError(f"{self.name}: the frame is refused: it has {sizes}")
        # All values of the metadata are optional (manual, AdornedImageMetadata).
        scan = getattr(image.metadata, "scan_settings", None)
        dwell_s, row_s = getattr(scan, "dwell_time", None), getattr(scan, "line_time", None)
        if dwell_s is not None and not abs(dwell_s - before.dwell_time_s) <= _RELATIVE_TOLERANCE * before.dwell_time_s:
            raise LinkError(f"{self.name}: the frame is refused: its dwell time is {dwell_s:g} s instead of {before.dwell_time_s:g} s")
        self._row_time_s = row_s if row_s is not None and row_s > 0 else None
        image.save(str(frame.image))
        if not frame.image.is_file():
            raise LinkError(f"{self.name}: the image was not written to {frame.image}")
        return end_ns, None

    def close(self) -> None:
        """Disconnect; never raises."""
        with contextlib.suppress(Exception):
            self._microscope.disconnect()


def _trigger(config: AutoScriptSettings, clock: ClockSource) -> MicroscopeTrigger:
    return MicroscopeTrigger(lambda: AutoScriptSession(config, clock), config, f"AutoScript at {config.host}")


_DRIVER = MicroscopeDriver("autoscript trigger", AutoScriptSettings, _trigger)
open_trigger, check_device = _DRIVER.open_trigger, _DRIVER.check_device
