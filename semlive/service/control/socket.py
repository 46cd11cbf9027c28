"""Control socket: requests of other processes on this computer to a run, authenticated by a token.

Each connection carries one request: a line of JSON, answered by a line of JSON. The socket listens on loopback, on a port that the system
chooses. The token is new with every start of the daemon and is never stored. A request without it receives only a delayed rejection.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import secrets
import socket
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from semlive.engine import OperatorCommand

LINE_BYTES = 4096
_HOST = "127.0.0.1"
_REPLY_TIMEOUT_S = 5.0
# A request is one line that is sent at once: a connection without a line is closed after this time.
_REQUEST_TIMEOUT_S = 2.0
# Connections that have not shown the token. A new one always gets a place; beyond this number the oldest is closed.
_MAX_UNAUTHENTICATED = 128
# asyncio accepts so many connections before it reads from any. It is less than _MAX_UNAUTHENTICATED, so a connection whose request was sent
# with it is read before it can have become the oldest.
_BACKLOG = 16
# Connections that wait in the system; so few that a flood of connections delays other requests by tenths of a second only.
_QUEUE_LENGTH = 256
# Delay after a wrong token. It protects the time of the loop, not the token, whose 128 bits cannot be guessed.
_WRONG_TOKEN_DELAY_S = 0.25
# A connection can be closed in favour of others before its request was read. Requests that only stop motion are then sent again, because
# executing them twice has the same effect.
_REPEATABLE = frozenset({OperatorCommand.PAUSE, OperatorCommand.STOP, OperatorCommand.ABORT})
_RETRY_S = 0.02


def token_digest(token: str) -> str:
    """SHA-256 of a token, in hexadecimal: it verifies a token but does not reveal it."""
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()


@dataclass(frozen=True, slots=True)
class SocketAddress:
    """Address of the control socket of a run.

    Attributes:
        host: address of this computer.
        port: TCP port.
        token: token of the run, which each request must contain.
    """

    host: str
    port: int
    token: str


class RequestContent(BaseModel):
    """Content of a request: a command, the answer to a question, or the acknowledgement of an alarm.

    Attributes:
        `say`: command of the operator; the key is a contract.
        question: name of the answered question.
        answer: the answer, one line.
        acknowledge: identity of the acknowledged alarm (`Alarm.identity`).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    say: OperatorCommand | None = None
    question: str | None = Field(default=None, max_length=100)
    answer: str = Field(default="", max_length=200, pattern=r"^[^\r\n]*$")
    acknowledge: str | None = Field(default=None, pattern=r"^[0-9]{1,20}$")

    @model_validator(mode="after")
    def _require_single_purpose(self) -> RequestContent:
        if [self.say, self.question, self.acknowledge].count(None) != 2:
            raise ValueError("give one command, answer one question or acknowledge one alarm")
        return self


class Request(RequestContent):
    """Request with the token of the run, as sent to the control socket.

    Attributes:
        token: token of the run.
        by: origin of the request, for the log.
    """

    token: str = Field(max_length=200)
    by: str = Field(default="", max_length=100)


class RequestStatus(StrEnum):
    """Status of a request."""

    ACCEPTED = "taken"
    UNAUTHORISED = "no_token"
    NO_REQUEST = "no_request"
    QUESTION_CLOSED = "not_open"


class Reply(BaseModel):
    """Reply to a request: its status, and the reason if it was rejected."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    heard: RequestStatus
    text: str = ""


class ControlSocket:
    """Server of the control socket during a run; belongs to the loop that opened it.

    Silent connections and wrong tokens cannot block an authenticated request: connections are counted when they are accepted, and if there
    are too many, the oldest unauthenticated one is closed.

    Args:
        on_command: callback with a command and its origin, in the loop.
        answer: callback with the name of a question and the answer; returns whether the question was open. In a thread: it may block.
        acknowledge: callback with the identity of an alarm and the origin; returns whether the alarm was unacknowledged. In the loop.
    """

    def __init__(
        self,
        on_command: Callable[[OperatorCommand, str], object],
        answer: Callable[[str, str], bool],
        acknowledge: Callable[[str, str], bool],
    ) -> None:
        self._on_command, self._answer, self._acknowledge = on_command, answer, acknowledge
        self._token = secrets.token_urlsafe(16)
        self._server: asyncio.Server | None = None
        self._unauthenticated: dict[asyncio.StreamWriter, None] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self) -> SocketAddress:
        """Open the socket and return its address."""
        listening = socket.create_server((_HOST, 0), backlog=_BACKLOG)
        self._server = await asyncio.start_server(self._accepted, sock=listening, limit=LINE_BYTES, backlog=_BACKLOG)
        listening.listen(_QUEUE_LENGTH)
        return SocketAddress(_HOST, listening.getsockname()[1], self._token)

    def close(self) -> None:
        """Close the socket."""
        if self._server is not None:
            self._server.close()

    def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Count a connection before anything is read from it."""
        self._unauthenticated[writer] = None
        if len(self._unauthenticated) > _MAX_UNAUTHENTICATED:
            oldest = next(iter(self._unauthenticated))
            del self._unauthenticated[oldest]
            oldest.transport.abort()
        task = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(_REQUEST_TIMEOUT_S):
                line = await reader.readline()
            async with asyncio.timeout(_REPLY_TIMEOUT_S):
                reply = await self._handle_line(line, writer)
                writer.write(reply.model_dump_json().encode() + b"\n")
                await writer.drain()
        except (TimeoutError, ValueError, OSError):
            # Too slow, too long, or closed by the peer: no reply is possible.
            pass
        finally:
            self._unauthenticated.pop(writer, None)
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def _handle_line(self, line: bytes, writer: asyncio.StreamWriter) -> Reply:
        try:
            request = Request.model_validate_json(line)
        except ValidationError as error:
            return Reply(heard=RequestStatus.NO_REQUEST, text=f"not understood: {error.errors()[0]['msg']}")
        if not hmac.compare_digest(request.token.encode(), self._token.encode()):
            await asyncio.sleep(_WRONG_TOKEN_DELAY_S)
            return Reply(
                heard=RequestStatus.UNAUTHORISED, text="the token is not that of this run; open the address that semlive run shows"
            )
        self._unauthenticated.pop(writer, None)
        if request.say is not None:
            self._on_command(request.say, request.by)
            return Reply(heard=RequestStatus.ACCEPTED)
        if request.acknowledge is not None:
            if not self._acknowledge(request.acknowledge, request.by):
                return Reply(heard=RequestStatus.QUESTION_CLOSED, text="this alarm is acknowledged already, or unknown")
            return Reply(heard=RequestStatus.ACCEPTED)
        loop = asyncio.get_running_loop()
        if not await loop.run_in_executor(None, self._answer, request.question or "", request.answer):
            return Reply(heard=RequestStatus.QUESTION_CLOSED, text="this question is not open any more")
        return Reply(heard=RequestStatus.ACCEPTED)


async def send_request(host: str, port: int, request: Request) -> Reply:
    """Send a request to a run and return the reply.

    Raises:
        OSError: there is no listener, or no reply in time; the run is over.
    """
    async with asyncio.timeout(_REPLY_TIMEOUT_S):
        while True:
            try:
                return await _exchange(host, port, request)
            except (ConnectionResetError, BrokenPipeError, ConnectionAbortedError):
                if request.say not in _REPEATABLE:
                    raise
                await asyncio.sleep(_RETRY_S)


async def _exchange(host: str, port: int, request: Request) -> Reply:
    """Exchange one request and one reply on a new connection.

    Raises:
        ConnectionResetError: the connection was closed without a reply.
        OSError: there is no listener.
    """
    reader, writer = await asyncio.open_connection(host, port, limit=LINE_BYTES)
    try:
        writer.write(request.model_dump_json(exclude_none=True).encode() + b"\n")
        await writer.drain()
        line = await reader.readline()
    finally:
        writer.close()
    try:
        return Reply.model_validate_json(line)
    except ValidationError as error:
        raise ConnectionResetError("the run closed the connection without a reply") from error
