"""HTTP routes of the page. Only `/say` is not read-only: it forwards a command of the operator with its token, which is not stored."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect
from starlette.requests import Request as HttpRequest
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from semlive.errors import SemliveError
from semlive.service.control.socket import Request, RequestContent, RequestStatus, send_request, token_digest
from semlive.web.access_control import AccessControl
from semlive.web.admission import Admission, Stage, is_loopback
from semlive.web.broadcaster import LogBroadcaster
from semlive.web.frame_images import mask_png
from semlive.web.newest_image import newest_image_png, run_mask

STATIC = Path(__file__).with_name("static")
MAX_VIEWERS = 100
MAX_VIEWERS_OF_AN_ADDRESS = 24
"""Limit for an address of another computer; local addresses may belong to a tunnel or a proxy."""
_HEARTBEAT_S = 2.0
_BODY_TIMEOUT_S = 5.0
# Delay after a wrong token. A token of 128 bits cannot be guessed; the delay limits the load by attempts.
_WRONG_TOKEN_DELAY_S = 0.25
_STATUS = {RequestStatus.ACCEPTED: 200, RequestStatus.UNAUTHORISED: 403, RequestStatus.NO_REQUEST: 400, RequestStatus.QUESTION_CLOSED: 409}


@dataclass(frozen=True, slots=True)
class ControlAddress:
    """Address of the control socket, and the digest that verifies its token.

    Attributes:
        host: address of this computer.
        port: TCP port.
        token_sha256: SHA-256 of the token of the run, in hexadecimal: verifies a token, but does not reveal it.
    """

    host: str
    port: int
    token_sha256: str


class Viewing(StreamingResponse):
    """Stream that is counted from the acceptance of its request until its end."""

    def __init__(self, content: AsyncIterator[str], ended: Callable[[], object], headers: dict[str, str]) -> None:
        super().__init__(content, media_type="text/event-stream", headers=headers)
        self._ended = ended

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._ended()


class PageHandlers:
    """Request handlers and their common state.

    Args:
        hub: reader of the log.
        control: address of the control socket; None for a read-only page.
        admission: connections of the server, whose stage is updated here.
    """

    def __init__(self, hub: LogBroadcaster, control: ControlAddress | None, admission: Admission) -> None:
        self._hub, self._control, self._admission = hub, control, admission
        self._viewers: Counter[str] = Counter()

    async def index(self, _: HttpRequest) -> Response:
        """Return the HTML page."""
        return FileResponse(STATIC / "index.html", headers={"cache-control": "no-cache"})

    async def about(self, _: HttpRequest) -> Response:
        """Return whether the page can send commands."""
        return JSONResponse({"controls": self._control is not None}, headers={"cache-control": "no-store"})

    async def events(self, request: HttpRequest) -> Response:
        """Stream the changes until the viewer disconnects."""
        host = "" if request.client is None else request.client.host
        max_viewers = MAX_VIEWERS if is_loopback(host) else MAX_VIEWERS_OF_AN_ADDRESS
        if self._viewers.total() >= MAX_VIEWERS or self._viewers[host] >= max_viewers:
            return Response("too many viewers; close another page", 503, headers={"retry-after": "30"})
        # Counted before the first await, so that simultaneous requests are all counted.
        self._viewers[host] += 1
        self._enter(request, Stage.VIEWING)
        return Viewing(self._events(), lambda: self._leave(host), {"cache-control": "no-store", "x-accel-buffering": "no"})

    async def field(self, request: HttpRequest) -> Response:
        """Return a map as float32."""
        data = await run_in_threadpool(self._hub.fields.read, request.path_params["frame"], request.path_params["name"])
        if data is None:
            raise HTTPException(404, "no such map")
        return Response(data, media_type="application/octet-stream", headers={"cache-control": "private, max-age=3600"})

    async def frame(self, request: HttpRequest) -> Response:
        """Return the newest exported file as PNG."""
        try:
            picture = await run_in_threadpool(newest_image_png, self._hub, request.path_params["export"])
        except SemliveError as error:
            raise HTTPException(422, str(error)) from error
        if picture is None:
            raise HTTPException(404, "a newer frame has arrived")
        return _picture(*picture)

    async def frame_image(self, request: HttpRequest) -> Response:
        """Return the image of a frame with maps as PNG."""
        picture = await run_in_threadpool(self._hub.images.read, request.path_params["frame"])
        if picture is None:
            raise HTTPException(404, "no such image")
        return _picture(*picture)

    async def mask(self, _: HttpRequest) -> Response:
        """Return the mask of the run as a PNG that is laid over an image."""
        mask = await run_in_threadpool(run_mask, self._hub)
        if mask is None:
            raise HTTPException(404, "no mask")
        height, width = mask.shape
        return _picture(await run_in_threadpool(mask_png, mask), (width, height))

    async def command(self, request: HttpRequest) -> Response:
        """Forward a command, an answer or an acknowledgement of the operator to the run."""
        if self._control is None:
            return _reply("this page cannot control a run; use the page that semlive run opens", 405)
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        authorised = kind == "Bearer" and hmac.compare_digest(token_digest(token), self._control.token_sha256)
        if authorised:
            self._enter(request, Stage.AUTHENTICATED)
        try:
            async with asyncio.timeout(_BODY_TIMEOUT_S):
                body = await request.body()
            command = RequestContent.model_validate_json(body)
        except (TimeoutError, ClientDisconnect):
            return _reply("the request did not arrive in time; send it again", 408)
        except ValidationError:
            return _reply("the request has the wrong form", 400)
        if not authorised:
            await asyncio.sleep(_WRONG_TOKEN_DELAY_S)
            return _reply("the token is not that of this run; open the address that semlive run shows", 403)
        by = f"page at {request.client.host}" if request.client is not None else "page"
        return await self._forward(Request(**command.model_dump(), token=token, by=by), self._control)

    async def _forward(self, request: Request, control: ControlAddress) -> Response:
        try:
            reply = await send_request(control.host, control.port, request)
        except (OSError, TimeoutError):
            return _reply("the run does not reply; it has ended, or its terminal shows the reason", 502)
        return _reply(reply.text, _STATUS[reply.heard])

    def _enter(self, request: HttpRequest, stage: Stage) -> None:
        if request.client is not None:
            self._admission.enter((request.client.host, request.client.port), stage)

    def _leave(self, host: str) -> None:
        self._viewers[host] -= 1
        if not self._viewers[host]:
            del self._viewers[host]

    async def _events(self) -> AsyncIterator[str]:
        version = -1
        yield "retry: 1000\n\n"
        while True:
            version, texts = await self._hub.changes(version, _HEARTBEAT_S)
            yield "".join(f"data: {text}\n\n" for text in texts) or f"data: {self._hub.heartbeat()}\n\n"


def _picture(png: bytes, size_px: tuple[int, int]) -> Response:
    """An image with the size of its frame."""
    headers = {"cache-control": "private, max-age=3600", "x-frame-size": f"{size_px[0]} {size_px[1]}"}
    return Response(png, media_type="image/png", headers=headers)


def _reply(text: str, status: int) -> JSONResponse:
    return JSONResponse({"text": text}, status)


def make_app(
    hub: LogBroadcaster, control: ControlAddress | None, names: Iterable[str] = (), admission: Admission | None = None
) -> Starlette:
    """Return the web application for a hub.

    Args:
        hub: reader of the log; started and closed with the application.
        control: address of the control socket; None for a read-only page.
        names: further names of this computer.
        admission: connections of the server; None if they are not limited.
    """
    page = PageHandlers(hub, control, admission or Admission())

    @contextlib.asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()
        # Errors of a single connection are not printed on the terminal of the run.
        loop.set_exception_handler(lambda _loop, _context: None)
        hub.start(loop)
        try:
            yield
        finally:
            hub.close()

    routes = [
        Route("/", page.index),
        Route("/about", page.about),
        Route("/events", page.events),
        Route("/field/{frame:int}/{name:str}", page.field),
        Route("/frame/{export:int}.png", page.frame),
        Route("/image/{frame:int}.png", page.frame_image),
        Route("/mask.png", page.mask),
        Route("/say", page.command, methods=["POST"]),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    return Starlette(routes=routes, middleware=[Middleware(AccessControl, names=tuple(names))], lifespan=life)
