"""One serial line: silence before each request, a deadline for each answer, and a memory of what was never answered.

An answer on a serial line carries no number. One that comes after its time would be taken for the answer to the next request, so what
was not answered is remembered by the line's path for as long as the process lives, also when the line was closed and opened again.
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
"""Start, eight data, parity or a second stop, stop: what the standard counts for a character."""
_FASTEST_SILENCE_S = 1.75e-3
"""The standard's silence at more than 19,200 baud, where 3.5 characters are shorter than computers can tell."""
_QUIET_S = 0.02
_WRITE_S = 0.5
_LONGEST_NOISE_S = 0.5


class LineLost(LinkError):
    """The line itself is gone: pulled out, or closed."""


class SerialSettings(BaseModel):
    """How a serial line is set; a device's map holds its usual values, the configuration those of this machine."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str
    """``/dev/ttyUSB0``, ``COM3``."""
    baud: int = Field(default=19_200, ge=300, le=4_000_000)
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    silence_s: float = Field(default=0.0, ge=0, le=1)
    """Least silence before a request; never less than the 3.5 characters of the standard."""
    echo: bool = False
    """A two-wire line that hears its own requests."""
    slowest_s: float = Field(default=1.0, gt=0, le=3)
    """No answer comes later than this, if it comes at all; how long a line of unknown past is listened to before it is believed."""


@dataclass(slots=True)
class LineHistory:
    """What is known of a line's past.

    Attributes:
        replies_pending: requests without an answer so far, oldest first, by unit.
        asked_s: monotonic time of the newest of them.
        first: what to say before anything else when the line is opened again: stops that nobody has confirmed.
    """

    replies_pending: dict[int, list[bytes]] = field(default_factory=dict)
    asked_s: float = field(default_factory=time.monotonic)
    first: list[bytes] = field(default_factory=list)


_PASTS: dict[tuple[str, str], LineHistory] = {}
"""By path and by who is spoken to there: a stop is owed to that device, not to what was plugged in instead."""


class SerialPort:
    """An open line. Not thread-safe: one thread owns it.

    Args:
        settings: of the line.
        who: is spoken to, as the descriptions call it.

    Raises:
        LinkRefused: if it cannot be opened, or another process uses it.
    """

    def __init__(self, settings: SerialSettings, who: str) -> None:
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
        character = 3.5 * self._byte_s if settings.baud <= 19_200 else _FASTEST_SILENCE_S
        self._silence_s = max(character, settings.silence_s)
        self._busy_s = time.monotonic()
        self.unknown = (settings.port, who) not in _PASTS
        self.past = _PASTS.setdefault((settings.port, who), LineHistory())

    def allow_for(self, settings: SerialSettings) -> None:
        """Another device on the same line, which may need more silence and more patience."""
        silence_s, slowest_s = max(self.settings.silence_s, settings.silence_s), max(self.settings.slowest_s, settings.slowest_s)
        self.settings = self.settings.model_copy(update={"silence_s": silence_s, "slowest_s": slowest_s})
        self._silence_s = max(self._silence_s, silence_s)

    def take_bytes_s(self, count: int) -> float:
        """How long so many bytes take on the wire."""
        return count * self._byte_s

    def write(self, data: bytes) -> bool:
        """Send a request after the silence that it needs.

        Returns:
            True if the line was silent before, False if something came unasked (it is thrown away).

        Raises:
            LinkError: if the line is gone.
        """
        silent = not self.read_until(max(0.0, self._busy_s + self._silence_s - time.monotonic()))
        try:
            self._port.write(data)
        except (OSError, serial.SerialException) as error:
            raise self._gone(error) from error
        self._busy_s = time.monotonic() + self.take_bytes_s(len(data))
        self.past.asked_s = time.monotonic()
        return silent

    def read(self, until_s: float) -> bytes:
        """What has come, as soon as anything has; nothing at `until_s` (monotonic).

        Raises:
            LinkError: if the line is gone.
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
        """Everything that comes within a time."""
        end_s, heard = time.monotonic() + seconds, b""
        while more := self.read(end_s):
            heard += more
        return heard

    def drain(self) -> None:
        """Throw away what comes until nothing comes any more.

        Raises:
            LinkError: if it never ends.
        """
        end_s = time.monotonic() + _LONGEST_NOISE_S
        while self.read_until(_QUIET_S):
            if time.monotonic() > end_s:
                raise LinkError(f"{self.where} does not fall silent; check baud rate, parity and who else speaks on the line")

    def wait_max_reply_time(self) -> None:
        """Listen until no answer to an earlier request can come any more."""
        self.read_until(max(0.0, self.past.asked_s + self.settings.slowest_s - time.monotonic()))
        self.past.replies_pending.clear()
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
    """The line, exclusively where the system can.

    Raises:
        LinkRefused: if it cannot be opened or set.
    """
    parity = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}[settings.parity]
    # A write does not block for long either: an adapter that hangs takes no bytes, and a stop must not wait for it.
    times = {"timeout": 0, "write_timeout": _WRITE_S}
    try:
        return serial.Serial(settings.port, settings.baud, parity=parity, stopbits=settings.stop_bits, exclusive=True, **times)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LinkRefused(f"{settings.port} cannot be opened ({reason}); check the cable, the path and who else uses it") from error
    except Exception as error:  # termios.error, where parity or speed cannot be set: no OSError
        raise LinkRefused(
            f"{settings.port} cannot be set to {settings.baud} baud, parity {settings.parity} ({error}); check both"
        ) from error
