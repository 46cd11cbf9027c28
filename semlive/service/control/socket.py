"""Control's door: what other processes of this computer may ask of a run, with its token.

One request a connection: a line of JSON, answered by a line of JSON. The door listens on loopback, on a port that the system chooses;
the token is new with every start of the daemon and is written nowhere. Whoever does not know it gets nothing but a late no.
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
_PATIENCE_S = 5.0
# A request is one line that is sent at once: a connection that stays silent for longer has nothing to say.
_SILENT_S = 2.0
# Connections that have not shown the token. A new one always gets a place; beyond this number the oldest is closed.
_MAX_UNKNOWN = 128
# asyncio accepts so many connections before it reads from any. It is less than _MAX_UNKNOWN, so a connection whose request was sent with it
# is read before it can have become the oldest.
_BACKLOG = 16
# More may wait in the system; so few that whoever opens connections without pause delays others by tenths of a second.
_WAITING = 256
# A token has 128 bits, so this keeps nobody from guessing it; it keeps those who try from taking the loop's time.
_WRONG_TOKEN_S = 0.25
# A connection can be closed in favour of others before its request was read. Requests that only stop motion are then sent again: they have
# the same effect when they are carried out twice.
_REPEATABLE = frozenset({OperatorCommand.PAUSE, OperatorCommand.STOP, OperatorCommand.ABORT})
_AGAIN_S = 0.02


def token_digest(token: str) -> str:
    """SHA-256 of a token, in hexadecimal: whoever knows it can check a token and cannot make one."""
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()


@dataclass(frozen=True, slots=True)
class SocketAddress:
    """Where a run can be spoken to.

    Attributes:
        host: of this computer.
        port: TCP.
        token: what a request must show.
    """

    host: str
    port: int
    token: str


class Asked(BaseModel):
    """One thing that is asked: a verb, the answer to a question, or the acknowledgement of an alarm.

    Attributes:
        say: what the operator says.
        question: name of the question that is answered.
        answer: the answer, one line.
        acknowledge: identity of the alarm that is acknowledged (`Alarm.identity`).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    say: OperatorCommand | None = None
    question: str | None = Field(default=None, max_length=100)
    answer: str = Field(default="", max_length=200, pattern=r"^[^\r\n]*$")
    acknowledge: str | None = Field(default=None, pattern=r"^[0-9]{1,20}$")

    @model_validator(mode="after")
    def _asks_one_thing(self) -> Asked:
        if [self.say, self.question, self.acknowledge].count(None) != 2:
            raise ValueError("say a verb, answer a question or acknowledge an alarm")
        return self


class Request(Asked):
    """The same with the run's token, as the door takes it.

    Attributes:
        token: of the run.
        by: where it comes from, for the log.
    """

    token: str = Field(max_length=200)
    by: str = Field(default="", max_length=100)


class RequestStatus(StrEnum):
    """What became of a request."""

    ACCEPTED = "taken"
    UNAUTHORISED = "no_token"
    NO_REQUEST = "no_request"
    QUESTION_CLOSED = "not_open"


class Reply(BaseModel):
    """The answer: what became of a request, and a sentence where it was not taken."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    heard: RequestStatus
    text: str = ""


class ControlSocket:
    """Listens for as long as a run lasts; belongs to the loop that opened it.

    Silent connections and wrong tokens cannot keep a request with the token away: connections are counted when they are accepted, and the
    oldest of those that have not shown the token is closed when there are too many.

    Args:
        say: told a verb and where it came from; in the loop.
        answer: told a question's name and the answer's line, says whether it was open; in a thread, because a terminal may block it.
        acknowledge: given an alarm's identity and where the request came from, says whether the alarm was open; in the loop.
    """

    def __init__(
        self,
        say: Callable[[OperatorCommand, str], object],
        answer: Callable[[str, str], bool],
        acknowledge: Callable[[str, str], bool],
    ) -> None:
        self._say, self._answer, self._acknowledge = say, answer, acknowledge
        self._token = secrets.token_urlsafe(16)
        self._server: asyncio.Server | None = None
        self._unknown: dict[asyncio.StreamWriter, None] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self) -> SocketAddress:
        """Listen."""
        listening = socket.create_server((_HOST, 0), backlog=_BACKLOG)
        self._server = await asyncio.start_server(self._accepted, sock=listening, limit=LINE_BYTES, backlog=_BACKLOG)
        listening.listen(_WAITING)
        return SocketAddress(_HOST, listening.getsockname()[1], self._token)

    def close(self) -> None:
        """Listen no more."""
        if self._server is not None:
            self._server.close()

    def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Count a connection before anything is read from it."""
        self._unknown[writer] = None
        if len(self._unknown) > _MAX_UNKNOWN:
            oldest = next(iter(self._unknown))
            del self._unknown[oldest]
            oldest.transport.abort()
        task = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(_SILENT_S):
                line = await reader.readline()
            async with asyncio.timeout(_PATIENCE_S):
                reply = await self._heard(line, writer)
                writer.write(reply.model_dump_json().encode() + b"\n")
                await writer.drain()
        except (TimeoutError, ValueError, OSError):
            # Too slow, too long, or gone: nobody waits for an answer.
            pass
        finally:
            self._unknown.pop(writer, None)
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def _heard(self, line: bytes, writer: asyncio.StreamWriter) -> Reply:
        try:
            request = Request.model_validate_json(line)
        except ValidationError as error:
            return Reply(heard=RequestStatus.NO_REQUEST, text=f"not understood: {error.errors()[0]['msg']}")
        if not hmac.compare_digest(request.token.encode(), self._token.encode()):
            await asyncio.sleep(_WRONG_TOKEN_S)
            return Reply(
                heard=RequestStatus.UNAUTHORISED, text="the token is not that of this run; open the address that semlive run shows"
            )
        self._unknown.pop(writer, None)
        if request.say is not None:
            self._say(request.say, request.by)
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
    """Ask something of a run.

    Raises:
        OSError: nobody listens there, or not in time; the run is over.
    """
    async with asyncio.timeout(_PATIENCE_S):
        while True:
            try:
                return await _exchange(host, port, request)
            except (ConnectionResetError, BrokenPipeError, ConnectionAbortedError):
                if request.say not in _REPEATABLE:
                    raise
                await asyncio.sleep(_AGAIN_S)


async def _exchange(host: str, port: int, request: Request) -> Reply:
    """One connection, one request, one reply.

    Raises:
        ConnectionResetError: the connection was closed without a reply.
        OSError: nobody listens there.
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
