"""Trigger `smartsem`: a ZEISS microscope scans one frame on request, through the COM object of the SmartSEM Remote API (Windows only).

Sources: the public clients `SBEMimage/SBEMimage` (`sem_control_zeiss.py`; Merlin, GeminiSEM, Sigma), `sklumpe/SerialFIB`
(`Zeiss/SEM_API.py`, with the codes of errors) and the documentation of ZeissTrial (T. Zhang). Facts from them that are used here:

- Object ``CZ.EMApiCtrl.1``; ``InitialiseRemoting()`` connects, ``ClosingControl()`` disconnects; 0 is success.
- ``Get(name, VARIANT)`` returns (code, value): with a text the value as it is displayed, with its unit; with a number the value, m for
  lengths.
- ``DP_RUNUPSTATE`` is ``Beam On``; ``DP_FROZEN`` is ``Live`` or ``Frozen``; ``DP_FREEZE_ON`` 0 is ``End Frame``; ``DP_IMAGE_STORE`` is
  ``1024*768``.
- ``CMD_UNFREEZE_ALL``, then ``CMD_FREEZE_ALL``: a scan begins and is frozen at its end. ``Grab(0, 0, 1024, 768, 0, path)`` writes the
  image in its stored resolution as TIFF with all metadata.
- ``AP_LINE_TIME`` over the columns is the dwell time of the image: ``DP_DWELL_TIME`` is not (files of several microscopes).

Unconfirmed: that the text of ``AP_LINE_TIME`` ends in its unit; ``AP_WIDTH`` as the field width in m; ``DP_BEAM_BLANKED`` as ``No`` or
``Yes``; that a scan begins again at ``CMD_UNFREEZE_ALL``; on which computer ``Grab`` writes (the clients give a path of the computer on
which they run). Stage, column and detector are never commanded.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import sys
import time
from typing import Any

from pydantic import Field

from semlive.data.scan_report import ScanReading
from semlive.errors import LinkError, LinkRefused
from semlive.ports import ClockSource
from semlive_drivers.microscope.driver import MicroscopeDriver
from semlive_drivers.microscope.frame_files import PendingFrame
from semlive_drivers.microscope.trigger import MicroscopeSettings, MicroscopeTrigger

_PROG_ID = "CZ.EMApiCtrl.1"
_POLL_S = 0.1
_START_S = 0.3
"""Time between the two commands of a scan, so that the state ``Frozen`` of the frame before is over, s."""
_TIME = re.compile(r"([0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?)\s*(ns|us|µs|μs|ms|s|secs?|mins?|minutes?)\.?\s*$")
_UNIT_S = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0, "secs": 1.0}
_STORE = re.compile(r"([0-9]{2,5})\s*\*\s*([0-9]{2,5})")
_ERRORS = {
    1000: "unknown parameter",
    1011: "unknown command",
    1016: "the image was not written",
    1019: "not initialised",
    1025: "no license for the Remote API",
    1032: "the command is disabled now",
    2027: "remoting is not configured (RConfigure)",
    2028: "remoting did not connect to the server",
    2030: "the EM Server is not running",
    2031: "no user is logged in at SmartSEM",
}
_COMPARED = ("DP_NOISE_REDUCTION", "DP_SCANRATE", "DP_DETECTOR_CHANNEL", "DP_SCAN_ROT", "DP_TILT_CORRECTION", "DP_DYNFOCUS", "DP_ZOOM")
"""Further settings that are reported and compared; a microscope without one of them reports it as unknown."""


class SmartSemSettings(MicroscopeSettings):
    """Settings of the trigger `smartsem`."""

    local: bool = False
    """SmartSEM runs on this computer (`Initialise`) instead of another one (`InitialiseRemoting`)."""
    settle_s: float = Field(default=0.5, ge=0, le=10)
    """Time between the end of the scan and the writing of its image, s."""


class SmartSemSession:
    """The Session of `semlive_drivers.microscope.trigger` over the COM object of SmartSEM.

    Args:
        settings: validated settings.
        clock: experiment time.

    Raises:
        LinkRefused: there is no such object on this computer, or it does not connect.
    """

    def __init__(self, settings: SmartSemSettings, clock: ClockSource) -> None:
        self._settings, self._clock = settings, clock
        self._com, self._variant = _windows_modules()
        self._com.CoInitialize()
        try:
            self._api = importlib.import_module("win32com.client").Dispatch(_PROG_ID)
            self._require(self._api.Initialise("") if settings.local else self._api.InitialiseRemoting(), "connecting")
        except LinkError:
            self._com.CoUninitialize()
            raise
        except Exception as error:
            self._com.CoUninitialize()
            raise LinkRefused(f"SmartSEM: {_PROG_ID} cannot be used ({error}); install the SmartSEM Remote API on this computer") from error
        self.name = f"ZEISS SmartSEM {self._optional('SV_SERIAL_NUMBER')}".strip()

    def read(self) -> ScanReading:
        """Read the settings of the scan; changes nothing.

        Raises:
            LinkError: the beam is off or blanked, or a value is missing or no number.
        """
        state = self._text("DP_RUNUPSTATE")
        if state != "Beam On":
            raise LinkError(f"{self.name}: its beam is not on but {state!r}; switch it on, then resume")
        if self._optional("DP_BEAM_BLANKED").lower() in ("yes", "on", "blanked"):
            raise LinkError(f"{self.name}: its beam is blanked; switch the blanking off, then resume")
        stored = _STORE.fullmatch(self._text("DP_IMAGE_STORE").strip())
        width_m = self._number("AP_WIDTH")
        if stored is None or not width_m > 0:
            raise LinkError(f"{self.name} reports the image size {self._text('DP_IMAGE_STORE')!r} and a field of {width_m:g} m")
        width_px, height_px = int(stored[1]), int(stored[2])
        row_s = self._time("AP_LINE_TIME")
        others = (*((name, self._optional(name)) for name in _COMPARED), ("AP_SCANROTATION", f"{self._number('AP_SCANROTATION'):.6g}"))
        return ScanReading(
            self._clock.now_ns(), row_s / width_px, row_s, width_m, width_px, height_px, tuple(pair for pair in others if pair[1])
        )

    def scan(self, before: ScanReading, frame: PendingFrame) -> tuple[int, float | None]:
        """Scan one frame and write it; returns the end of the scan (experiment time, ns), and no measured row time.

        Raises:
            LinkError: a command is refused, or the image is not written.
        """
        del before  # the scan has the settings of the microscope
        self._require(self._api.Set("DP_FREEZE_ON", self._variant(self._com.VT_R4, 0)), "freezing at the end of the frame")
        self._require(self._api.Execute("CMD_UNFREEZE_ALL"), "CMD_UNFREEZE_ALL")
        time.sleep(_START_S)
        self._require(self._api.Execute("CMD_FREEZE_ALL"), "CMD_FREEZE_ALL")
        deadline_s = time.monotonic() + self._settings.frame_timeout_s
        while self._text("DP_FROZEN") == "Live":
            if time.monotonic() > deadline_s:
                raise LinkError(f"{self.name}: the frame was not frozen within {self._settings.frame_timeout_s:g} s")
            time.sleep(_POLL_S)
        end_ns = self._clock.now_ns()
        time.sleep(self._settings.settle_s)
        self._require(self._api.Grab(0, 0, 1024, 768, 0, str(frame.image)), "writing the image")
        if not frame.image.is_file():
            raise LinkError(f"{self.name}: the image was not written to {frame.image}; the folder must be reachable under this path there")
        return end_ns, None

    def close(self) -> None:
        """Disconnect; never raises."""
        with contextlib.suppress(Exception):
            self._api.ClosingControl()
        with contextlib.suppress(Exception):
            self._com.CoUninitialize()

    def _require(self, result: Any, what: str) -> Any:
        """Return the value of a result; raise LinkError if its code is not 0."""
        code, value = (result[0], result[-1]) if isinstance(result, tuple) else (result, None)
        if code != 0:
            raise LinkError(f"SmartSEM: {what} failed: {_ERRORS.get(code, 'see its manual')} (code {code})")
        return value

    def _text(self, name: str) -> str:
        return str(self._require(self._api.Get(name, self._variant(self._com.VT_BSTR, "")), name))

    def _optional(self, name: str) -> str:
        try:
            return self._text(name)
        except LinkError:
            return ""

    def _number(self, name: str) -> float:
        value = self._require(self._api.Get(name, self._variant(self._com.VT_R4, 0.0)), name)
        try:
            return float(value)
        except (TypeError, ValueError):
            raise LinkError(f"{self.name} reports {value!r} as {name}, which is no number") from None

    def _time(self, name: str) -> float:
        text = self._text(name)
        found = _TIME.search(text)
        value_s = float(found[1]) * _UNIT_S.get(found[2], 60.0) if found else 0.0
        if not value_s > 0:
            raise LinkError(f"{self.name} reports {text!r} as {name}, which is no time with a unit")
        return value_s


def _trigger(config: SmartSemSettings, clock: ClockSource) -> MicroscopeTrigger:
    return MicroscopeTrigger(lambda: SmartSemSession(config, clock), config, "SmartSEM")


_DRIVER = MicroscopeDriver("smartsem trigger", SmartSemSettings, _trigger)
open_trigger, check_device = _DRIVER.open_trigger, _DRIVER.check_device


def _windows_modules() -> tuple[Any, Any]:
    """Return the module of COM and the class of its values, which exist on Windows only."""
    try:
        return importlib.import_module("pythoncom"), importlib.import_module("win32com.client").VARIANT
    except ImportError as error:
        if sys.platform != "win32":
            raise LinkRefused("SmartSEM: its Remote API is a COM object of Windows; run semlive on Windows for this trigger") from error
        raise LinkRefused("SmartSEM: the package pywin32 is missing; pip install 'semlive[smartsem]'") from error
