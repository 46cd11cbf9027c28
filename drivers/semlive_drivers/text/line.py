"""One serial line with a device that answers in lines of text; a late answer is never assigned to a later request."""

from __future__ import annotations

import time

from semlive.errors import LinkError
from semlive_drivers.serial_port import SerialPort, SerialSettings
from semlive_drivers.text.codec import printable

_DEVICE = 0
_MAX_REPLY_BYTES = 4096


class TextLine:
    """A line owned by one thread. After a missing reply it is out of step until `recover`.

    Args:
        settings: settings of the line.
        timeout_s: longest wait for one answer, s.
        device: name of the device on the line.

    Raises:
        LinkRefused: if the line cannot be opened.
    """

    def __init__(self, settings: SerialSettings, timeout_s: float, device: str) -> None:
        self._port, self._device = SerialPort(settings, device), device
        self._timeout_s = timeout_s
        self.where = settings.port
        for stop in self._port.history.pending_stops:
            self._port.write(stop)
        if self._port.unknown or self._pending:
            self.recover()

    def write(self, request: bytes) -> None:
        """Send a request that has no reply.

        Raises:
            LinkError: if the line is lost or out of step.
        """
        self._send(request)
        self._port.history.pending_stops.clear()

    def write_without_reply(self, request: bytes) -> None:
        """Send a request in any state of the line, and send it first when the line is opened again.

        A line that is closed or lost is opened for this request alone.

        Raises:
            LinkError: if the line is lost.
            LinkRefused: if the line cannot be opened.
        """
        for requests in (self._pending, self._port.history.pending_stops):
            if request not in requests:
                requests.append(request)
        try:
            self._port.write(request)
        except LinkError:
            reopened = SerialPort(self._port.settings, self._device)
            try:
                reopened.write(request)
            finally:
                reopened.close()

    def query(self, request: bytes, ends: bytes, lines: int) -> list[bytes]:
        """The lines of a reply, without their ends.

        Raises:
            LinkError: if they do not come in time; the line is then out of step until `recover`.
        """
        self._send(request)
        wait_s = self._timeout_s + self._port.take_bytes_s(len(request))
        until_s, received = time.monotonic() + wait_s, b""
        while data := self._port.read(until_s):
            received += data
            if self._port.settings.echo:
                received = received.removeprefix(request)
            if received.count(ends) >= lines or len(received) > _MAX_REPLY_BYTES:
                break
        if received.count(ends) == lines and received.endswith(ends):
            return received.split(ends)[:lines]
        self._pending.append(request)
        problem = f"gave no complete answer within {self._timeout_s:g} s" if received.count(ends) < lines else "sent extra lines"
        raise LinkError(f"{self.where} {problem} to {printable(request)} ({printable(received)} came); check cable, baud rate and device")

    def recover(self) -> None:
        """Wait until no late reply is possible any more.

        Raises:
            LinkError: if the line is lost or does not become silent.
        """
        self._port.wait_max_reply_time()
        self._port.drain()

    def close(self) -> None:
        """Close the line; its pending replies remain stored."""
        self._port.close()

    @property
    def _pending(self) -> list[bytes]:
        return self._port.history.replies_pending.setdefault(_DEVICE, [])

    def _send(self, request: bytes) -> None:
        if self._pending:
            raise LinkError(f"{self.where} is out of step: an earlier answer is still pending")
        if not self._port.write(request):
            self._pending.append(request)
            raise LinkError(f"{self.where} sent bytes without a request; check for other devices on the line")
