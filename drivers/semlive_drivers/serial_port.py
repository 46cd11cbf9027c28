"""One serial line: silence before each request, a deadline for each answer, and a history of unanswered requests.

An answer on a serial line carries no transaction number: a late one would be assigned to the next request. Unanswered requests are
therefore stored by the path of the line for the life of the process, also when the line is closed and opened again.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field
from typing import Literal

import serial
from pydantic import BaseModel, ConfigDict, Field

from semlive.errors import LinkError, LinkRefused
from semlive_drivers.endpoint_lock import reserve_serial

_BITS = 11
"""Bits of a character by the standard: start, eight data, parity or a second stop, stop."""
_MIN_SILENCE_S = 1.75e-3
"""Silence of the standard above 19,200 baud, where 3.5 characters are too short for timers of computers."""
_SILENT_AFTER_S = 0.02
"""Time without a byte after which a line is silent."""
_WRITE_TIMEOUT_S = 0.5
_MAX_DRAIN_S = 0.5
"""Longest time in which `SerialPort.drain` discards bytes."""


class LineLost(LinkError):
    """The line is lost: its adapter was removed, or it is closed."""


class SerialSettings(BaseModel):
    """Settings of a serial line; the description of a device holds the defaults, the configuration the values of this machine."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str
    """``/dev/ttyUSB0``, ``COM3``."""
    baud: int = Field(default=19_200, ge=300, le=4_000_000)
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    silence_s: float = Field(default=0.0, ge=0, le=1)
    """Smallest silence before a request; never less than the 3.5 characters of the standard."""
    echo: bool = False
    """True for a two-wire line that receives its own requests."""
    slowest_s: float = Field(default=1.0, gt=0, le=3)
    """Longest time to an answer; on a line of unknown history the program waits this long before the first request."""


@dataclass(slots=True)
class LineHistory:
    """Unanswered requests of a line.

    Attributes:
        replies_pending: requests without an answer, oldest first, by unit.
        request_s: monotonic time of the latest request, s.
        pending_stops: stops without an answer, which are sent first when the line is opened again.
    """

    replies_pending: dict[int, list[bytes]] = field(default_factory=dict)
    request_s: float = field(default_factory=time.monotonic)
    pending_stops: list[bytes] = field(default_factory=list)


_HISTORIES: dict[tuple[str, str], LineHistory] = {}
"""Histories by path and device name: a stop is sent again to the same device only, not to one that was connected instead."""


class SerialPort:
    """An open line. Not thread-safe: one thread owns it.

    Args:
        settings: settings of the line.
        device: name of the device on the line, as in its description.

    Raises:
        LinkRefused: if the line cannot be opened, or another process uses it.
    """

    def __init__(self, settings: SerialSettings, device: str) -> None:
        self.settings = settings
        self.where = settings.port
        self._closed = False
        self._endpoint = reserve_serial(settings.port)
        try:
            self._port = _opened(settings)
        except LinkRefused:
            self._endpoint.release()
            raise
        self._byte_s = _BITS / settings.baud
        character = 3.5 * self._byte_s if settings.baud <= 19_200 else _MIN_SILENCE_S
        self._silence_s = max(character, settings.silence_s)
        self._busy_s = time.monotonic()
        self.unknown = (settings.port, device) not in _HISTORIES
        self.history = _HISTORIES.setdefault((settings.port, device), LineHistory())

    def allow_for(self, settings: SerialSettings) -> None:
        """Adapt silence and waiting time to another device on the same line."""
        silence_s, slowest_s = max(self.settings.silence_s, settings.silence_s), max(self.settings.slowest_s, settings.slowest_s)
        self.settings = self.settings.model_copy(update={"silence_s": silence_s, "slowest_s": slowest_s})
        self._silence_s = max(self._silence_s, silence_s)

    def take_bytes_s(self, count: int) -> float:
        """Time of a number of bytes on the wire, s."""
        return count * self._byte_s

    def write(self, data: bytes) -> bool:
        """Send a request after the required silence.

        Returns:
            True if the line was silent before; False if bytes came without a request (they are discarded).

        Raises:
            LinkError: if the line is lost.
        """
        silent = not self.read_until(max(0.0, self._busy_s + self._silence_s - time.monotonic()))
        try:
            self._port.write(data)
        except (OSError, serial.SerialException) as error:
            raise self._gone(error) from error
        self._busy_s = time.monotonic() + self.take_bytes_s(len(data))
        self.history.request_s = time.monotonic()
        return silent

    def read(self, until_s: float) -> bytes:
        """Received bytes, as soon as there are any; empty at `until_s` (monotonic time, s).

        Raises:
            LinkError: if the line is lost.
        """
        try:
            if self._closed:
                raise serial.PortNotOpenError
            self._port.timeout = max(0.0, until_s - time.monotonic())
            data = self._port.read(1)
            if data:
                data += self._port.read(self._port.in_waiting)
                self._busy_s = time.monotonic()
        except (OSError, TypeError, serial.SerialException) as error:
            raise self._gone(error) from error
        return data

    def read_until(self, seconds: float) -> bytes:
        """All bytes received within a time, s."""
        end_s, received = time.monotonic() + seconds, b""
        while data := self.read(end_s):
            received += data
        return received

    def drain(self) -> None:
        """Discard received bytes until the line is silent.

        Raises:
            LinkError: if it does not become silent.
        """
        end_s = time.monotonic() + _MAX_DRAIN_S
        while self.read_until(_SILENT_AFTER_S):
            if time.monotonic() > end_s:
                raise LinkError(f"{self.where} does not fall silent; check baud rate, parity and other devices on the line")

    def wait_max_reply_time(self) -> None:
        """Wait until no answer to an earlier request is possible any more."""
        self.read_until(max(0.0, self.history.request_s + self.settings.slowest_s - time.monotonic()))
        self.history.replies_pending.clear()
        self.unknown = False

    def close(self) -> None:
        """Close the line; never raises."""
        self._closed = True
        with contextlib.suppress(OSError, serial.SerialException):
            self._port.close()
        self._endpoint.release()

    def _gone(self, error: Exception) -> LineLost:
        return LineLost(f"the serial line {self.where} is gone ({error}); check cable and adapter")


def _opened(settings: SerialSettings) -> serial.Serial:
    """Open a line, with exclusive access where the system supports it.

    Raises:
        LinkRefused: if the line cannot be opened or set.
    """
    parity = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}[settings.parity]
    # A write has a timeout too: an adapter that hangs accepts no bytes, and a stop must not wait for it.
    times = {"timeout": 0, "write_timeout": _WRITE_TIMEOUT_S}
    try:
        return serial.Serial(settings.port, settings.baud, parity=parity, stopbits=settings.stop_bits, exclusive=True, **times)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LinkRefused(f"{settings.port} cannot be opened ({reason}); check the cable, the path and who else uses it") from error
    except Exception as error:  # termios.error, where parity or speed cannot be set: no OSError
        raise LinkRefused(
            f"{settings.port} cannot be set to {settings.baud} baud, parity {settings.parity} ({error}); check both"
        ) from error
