"""The page's addresses. All but two only show; those two pass on what the operator says, with the operator's token, which is not kept."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterable
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request as Asked
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from semlive.errors import SemliveError
from semlive.service.door import Heard, Request, knock
from semlive.web.guard import Guard
from semlive.web.hub import Hub
from semlive.web.picture import newest_picture

STATIC = Path(__file__).with_name("static")
MAX_VIEWERS = 100
_BEAT_S = 2.0
# What waits for control at once: who tries tokens must not keep the operator's Stop waiting behind a crowd.
_CALLS_AT_ONCE = 8
_STATUS = {Heard.TAKEN: 200, Heard.NO_TOKEN: 403, Heard.NO_REQUEST: 400, Heard.NOT_OPEN: 409}


@dataclass(frozen=True, slots=True)
class Control:
    """Where the run listens."""

    host: str
    port: int


class Page:
    """The handlers, and what they share.

    Args:
        hub: reader of the log.
        control: where the run listens; None for a page that only shows.
    """

    def __init__(self, hub: Hub, control: Control | None) -> None:
        self._hub, self._control = hub, control
        self._viewers = 0
        self._calls = asyncio.Semaphore(_CALLS_AT_ONCE)

    async def index(self, _: Asked) -> Response:
        """The page itself."""
        return FileResponse(STATIC / "index.html", headers={"cache-control": "no-cache"})

    async def about(self, _: Asked) -> Response:
        """Whether anything can be said here."""
        return JSONResponse({"controls": self._control is not None}, headers={"cache-control": "no-store"})

    async def events(self, _: Asked) -> Response:
        """What changes, for as long as somebody looks."""
        if self._viewers >= MAX_VIEWERS:
            return Response("too many look on already", 503, headers={"retry-after": "30"})
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(self._events(), media_type="text/event-stream", headers=headers)

    async def field(self, asked: Asked) -> Response:
        """A map as float32."""
        data = await run_in_threadpool(self._hub.fields.read, asked.path_params["frame"], asked.path_params["name"])
        if data is None:
            raise HTTPException(404, "there is no such map")
        return Response(data, media_type="application/octet-stream", headers={"cache-control": "private, max-age=3600"})

    async def frame(self, asked: Asked) -> Response:
        """The newest exported file as PNG."""
        try:
            picture = await run_in_threadpool(newest_picture, self._hub, asked.path_params["export"])
        except SemliveError as error:
            raise HTTPException(422, str(error)) from error
        if picture is None:
            raise HTTPException(404, "a newer frame has come")
        png, (width, height) = picture
        headers = {"cache-control": "private, max-age=3600", "x-frame-size": f"{width} {height}"}
        return Response(png, media_type="image/png", headers=headers)

    async def say(self, asked: Asked) -> Response:
        """A verb or an answer of the operator's, passed on to the run."""
        if self._control is None:
            return JSONResponse({"text": "this page only shows; steer from the page that semlive run opens"}, 405)
        kind, _, token = asked.headers.get("authorization", "").partition(" ")
        by = f"page at {asked.client.host}" if asked.client is not None else "page"
        try:
            told = await asked.json()
            request = Request.model_validate({**told, "token": token if kind == "Bearer" else "", "by": by})
        except (ValueError, TypeError, ValidationError):
            return JSONResponse({"text": "not understood"}, 400)
        try:
            async with self._calls:
                reply = await knock(self._control.host, self._control.port, request)
        except (OSError, TimeoutError):
            return JSONResponse({"text": "the run does not answer; it is over, or look at its terminal"}, 502)
        return JSONResponse({"text": reply.text}, _STATUS[reply.heard])

    async def _events(self) -> AsyncIterator[str]:
        self._viewers += 1
        try:
            version = -1
            yield "retry: 1000\n\n"
            while True:
                version, texts = await self._hub.changes(version, _BEAT_S)
                yield "".join(f"data: {text}\n\n" for text in texts) or f"data: {self._hub.beat()}\n\n"
        finally:
            self._viewers -= 1


def make_app(hub: Hub, control: Control | None, names: Iterable[str] = ()) -> Starlette:
    """The application over a hub.

    Args:
        hub: reader of the log; begun and closed with the application.
        control: where the run listens; None for a page that only shows.
        names: further names of this computer.
    """
    page = Page(hub, control)

    @contextlib.asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        hub.begin(asyncio.get_running_loop())
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
        Route("/say", page.say, methods=["POST"]),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard, names=tuple(names))], lifespan=life)
