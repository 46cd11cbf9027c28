"""Control's door: what other processes of this computer may ask of a run, with its token.

One request a connection: a line of JSON, answered by a line of JSON. The door listens on loopback, on a port that the system chooses;
the token is new with every start of the daemon and is written nowhere. Whoever does not know it gets nothing but a late no.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from semlive.engine import Verb

LINE_BYTES = 4096
_HOST = "127.0.0.1"
_PATIENCE_S = 5.0
_MAX_CALLERS = 16
# A token has 128 bits, so this keeps nobody from guessing it; it keeps those who try from taking the loop's time.
_WRONG_TOKEN_S = 0.25


@dataclass(frozen=True, slots=True)
class Address:
    """Where a run can be spoken to.

    Attributes:
        host: of this computer.
        port: TCP.
        token: what a request must show.
    """

    host: str
    port: int
    token: str


class Request(BaseModel):
    """One thing that is asked: a verb, or the answer to a question.

    Attributes:
        token: of the run.
        say: what the operator says.
        question: name of the question that is answered.
        answer: the answer, one line.
        by: where it comes from, for the log.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    token: str = Field(max_length=200)
    say: Verb | None = None
    question: str | None = Field(default=None, max_length=100)
    answer: str = Field(default="", max_length=200, pattern=r"^[^\r\n]*$")
    by: str = Field(default="", max_length=100)

    @model_validator(mode="after")
    def _asks_one_thing(self) -> Request:
        if (self.say is None) == (self.question is None):
            raise ValueError("say a verb or answer a question")
        return self


class Heard(StrEnum):
    """What became of a request."""

    TAKEN = "taken"
    NO_TOKEN = "no_token"
    NO_REQUEST = "no_request"
    NOT_OPEN = "not_open"


class Reply(BaseModel):
    """The answer: what became of a request, and a sentence where it was not taken."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    heard: Heard
    text: str = ""


class Door:
    """Listens for as long as a run lasts; belongs to the loop that opened it.

    Args:
        say: told a verb and where it came from; in the loop.
        answer: told a question's name and the answer's line, says whether it was open; in a thread, because a terminal may block it.
    """

    def __init__(self, say: Callable[[Verb, str], object], answer: Callable[[str, str], bool]) -> None:
        self._say, self._answer = say, answer
        self._token = secrets.token_urlsafe(16)
        self._server: asyncio.Server | None = None
        self._callers = 0

    async def open(self) -> Address:
        """Listen."""
        self._server = await asyncio.start_server(self._called, _HOST, 0, limit=LINE_BYTES)
        return Address(_HOST, self._server.sockets[0].getsockname()[1], self._token)

    def close(self) -> None:
        """Listen no more."""
        if self._server is not None:
            self._server.close()

    async def _called(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._callers += 1
        try:
            if self._callers <= _MAX_CALLERS:
                async with asyncio.timeout(_PATIENCE_S):
                    reply = await self._heard(await reader.readline())
                    writer.write(reply.model_dump_json().encode() + b"\n")
                    await writer.drain()
        except (TimeoutError, ValueError, OSError):
            # Too slow, too long, or gone: nobody waits for an answer.
            pass
        finally:
            self._callers -= 1
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def _heard(self, line: bytes) -> Reply:
        try:
            request = Request.model_validate_json(line)
        except ValidationError as error:
            return Reply(heard=Heard.NO_REQUEST, text=f"not understood: {error.errors()[0]['msg']}")
        if not hmac.compare_digest(request.token.encode(), self._token.encode()):
            await asyncio.sleep(_WRONG_TOKEN_S)
            return Reply(heard=Heard.NO_TOKEN, text="the token is not that of this run; open the address that semlive run shows")
        if request.say is not None:
            self._say(request.say, request.by)
            return Reply(heard=Heard.TAKEN)
        loop = asyncio.get_running_loop()
        if not await loop.run_in_executor(None, self._answer, request.question or "", request.answer):
            return Reply(heard=Heard.NOT_OPEN, text="this question is not open any more")
        return Reply(heard=Heard.TAKEN)


async def knock(host: str, port: int, request: Request) -> Reply:
    """Ask something of a run.

    Raises:
        OSError: nobody listens there, or not in time; the run is over.
    """
    async with asyncio.timeout(_PATIENCE_S):
        reader, writer = await asyncio.open_connection(host, port, limit=LINE_BYTES)
        try:
            writer.write(request.model_dump_json().encode() + b"\n")
            await writer.drain()
            line = await reader.readline()
        finally:
            writer.close()
    try:
        return Reply.model_validate_json(line)
    except ValidationError as error:
        raise ConnectionError("the run did not answer") from error
