"""The two TCP connections of SharkSEM: commands with their replies, and image data (manual, "Session Management").

One command at a time, each with the flag "send response". An unknown command or a wrong argument is ignored by the server, so every reply
is awaited for a bounded time only. A reply that is not that of the last command is an error, never used.
"""

from __future__ import annotations

import contextlib
import socket
import time

from semlive.errors import LinkError, LinkRefused
from semlive_drivers.microscope.sharksem.messages import HEADER_BYTES, Body, Flag, Header, ScanData, header, request, scan_data

_SCAN_DATA = "ScData"


class Connection:
    """Control and data connection to a microscope.

    Args:
        host: address of the microscope's computer.
        port: port of the control connection; the data connection has the next one.
        timeout_s: longest time to connect, for a reply, and without image data, s.

    Raises:
        LinkRefused: nobody listens there.
        LinkError: the microscope does not register the data connection.
    """

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._where, self._timeout_s = f"SharkSEM at {host}:{port}", timeout_s
        self._identity = 0
        self._sockets: list[socket.socket] = []
        try:
            self._control = self._connected(host, port)
            # The server matches the data connection by its local port, which must be known to it before (manual, TcpRegDataPort).
            data = self._bound(self._control)
            self.command("TcpRegDataPort", data.getsockname()[1]).integer()
            self._data = self._connect(data, host, port + 1)
        except BaseException:
            self.close()
            raise

    def command(self, name: str, *arguments: int, wait: Flag = Flag(0)) -> Body:  # noqa: B008
        """Send a command and return its reply.

        Args:
            name: name of the command, at most 15 characters.
            arguments: its integer arguments.
            wait: conditions under which the microscope executes it.

        Raises:
            LinkError: the reply is late, wrong or truncated, or the connection is lost.
        """
        self._identity += 1
        deadline_s = time.monotonic() + self._timeout_s
        try:
            self._control.settimeout(self._timeout_s)
            self._control.sendall(request(name, arguments, self._identity, Flag.REPLY | wait))
            head = self._header(self._control, deadline_s, f"answer to {name}")
            body = self._exactly(self._control, head.body_bytes, deadline_s, f"answer to {name}")
            if (head.name, head.identity) != (name, self._identity):
                raise LinkError(f"answered {head.name} {head.identity} to {name} {self._identity}")
        except OSError as error:
            raise LinkError(f"{self._where}: the connection was lost at {name} ({error.strerror or error})") from error
        except LinkError as error:
            raise LinkError(f"{self._where}: {error}") from None
        return Body(name, body)

    def image_data(self, deadline_s: float) -> ScanData:
        """Return the next message of the data connection.

        Args:
            deadline_s: monotonic clock at which the frame must be complete, s.

        Raises:
            LinkError: none arrives in time, or it is truncated.
        """
        try:
            while True:
                until_s = min(deadline_s, time.monotonic() + self._timeout_s)
                head = self._header(self._data, until_s, "image data")
                body = self._exactly(self._data, head.body_bytes, until_s, "image data")
                if head.name == _SCAN_DATA:
                    return scan_data(body)
        except OSError as error:
            raise LinkError(f"{self._where}: the data connection was lost ({error.strerror or error})") from error
        except LinkError as error:
            raise LinkError(f"{self._where}: {error}") from None

    def close(self) -> None:
        """Close the data connection, then the control connection (manual, "Session Management"); never raises."""
        for link in reversed(self._sockets):
            with contextlib.suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
            with contextlib.suppress(OSError):
                link.close()

    def _connected(self, host: str, port: int) -> socket.socket:
        try:
            link = socket.create_connection((host, port), self._timeout_s)
        except OSError as error:
            raise LinkRefused(f"{self._where}: no answer ({error.strerror or error}); check address, port and firewall") from error
        self._sockets.append(link)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return link

    def _bound(self, control: socket.socket) -> socket.socket:
        """A socket of the same family with a local port, not connected yet."""
        link = socket.socket(control.family, socket.SOCK_STREAM)
        self._sockets.append(link)
        link.bind(("", 0))
        return link

    def _connect(self, link: socket.socket, host: str, port: int) -> socket.socket:
        link.settimeout(self._timeout_s)
        try:
            link.connect((host, port))
        except OSError as error:
            raise LinkRefused(
                f"{self._where}: no data connection at port {port} ({error.strerror or error}); check the firewall"
            ) from error
        return link

    def _header(self, link: socket.socket, deadline_s: float, what: str) -> Header:
        return header(self._exactly(link, HEADER_BYTES, deadline_s, what))

    def _exactly(self, link: socket.socket, size: int, deadline_s: float, what: str) -> bytes:
        """Receive `size` bytes; raises LinkError if they are late or the connection is closed before."""
        data = bytearray()
        while len(data) < size:
            remaining_s = deadline_s - time.monotonic()
            if remaining_s <= 0:
                raise LinkError(f"no {what} within {self._timeout_s:g} s")
            link.settimeout(remaining_s)
            try:
                piece = link.recv(min(size - len(data), 1 << 20))
            except TimeoutError:
                continue
            if not piece:
                raise LinkError(f"closed the connection before the {what} was complete")
            data += piece
        return bytes(data)
