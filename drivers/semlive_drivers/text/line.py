"""One serial line with a device that answers in lines of text; what comes late is waited out, never believed."""

from __future__ import annotations

import time

from semlive.errors import LinkError
from semlive_drivers.serial_port import SerialPort, SerialSettings
from semlive_drivers.text.codec import printable

_DEVICE = 0
_LONGEST = 4096


class TextLine:
    """A line owned by one thread. A reply that does not come in time leaves the line unbelieved until `recover`.

    Args:
        settings: of the line.
        timeout_s: longest wait for one answer.
        who: is spoken to.

    Raises:
        LinkRefused: if the line cannot be opened.
    """

    def __init__(self, settings: SerialSettings, timeout_s: float, who: str) -> None:
        self._port, self._who = SerialPort(settings, who), who
        self._timeout_s = timeout_s
        self.where = settings.port
        for stop in self._port.past.first:
            self._port.write(stop)
        if self._port.unknown or self._owed:
            self.recover()

    def write(self, request: bytes) -> None:
        """Send something that has no reply.

        Raises:
            LinkError: if the line is gone, or not believed.
        """
        self._send(request)
        self._port.past.first.clear()

    def write_without_reply(self, request: bytes) -> None:
        """Send something whatever the state of the line, and again first thing when it is opened anew.

        A line that is closed or gone is opened for this request alone.

        Raises:
            LinkError: if the line is gone.
            LinkRefused: if it cannot be opened.
        """
        for remembered in (self._owed, self._port.past.first):
            if request not in remembered:
                remembered.append(request)
        try:
            self._port.write(request)
        except LinkError:
            again = SerialPort(self._port.settings, self._who)
            try:
                again.write(request)
            finally:
                again.close()

    def query(self, request: bytes, ends: bytes, lines: int) -> list[bytes]:
        """The lines of a reply, without their ends.

        Raises:
            LinkError: if they do not come in time; the line is then not believed until `recover`.
        """
        self._send(request)
        wait_s = self._timeout_s + self._port.take_bytes_s(len(request))
        until_s, heard = time.monotonic() + wait_s, b""
        while more := self._port.read(until_s):
            heard += more
            if self._port.settings.echo:
                heard = heard.removeprefix(request)
            if heard.count(ends) >= lines or len(heard) > _LONGEST:
                break
        if heard.count(ends) == lines and heard.endswith(ends):
            return heard.split(ends)[:lines]
        self._owed.append(request)
        what = f"gave no whole answer within {self._timeout_s:g} s" if heard.count(ends) < lines else "said more than was asked"
        raise LinkError(f"{self.where} {what} to {printable(request)} ({printable(heard)} came); check cable, baud rate and device")

    def recover(self) -> None:
        """Listen until nothing late can come any more.

        Raises:
            LinkError: if the line is gone or does not fall silent.
        """
        self._port.wait_max_reply_time()
        self._port.drain()

    def close(self) -> None:
        """Close the line; what is owed is remembered."""
        self._port.close()

    @property
    def _owed(self) -> list[bytes]:
        return self._port.past.replies_pending.setdefault(_DEVICE, [])

    def _send(self, request: bytes) -> None:
        if self._owed:
            raise LinkError(f"{self.where} is not settled: an answer is still owed")
        if not self._port.write(request):
            self._owed.append(request)
            raise LinkError(f"{self.where} spoke unasked; check who else is on the line")
