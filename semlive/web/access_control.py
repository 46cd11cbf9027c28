"""Access control: valid host names, limited request size, and same-origin requests for all changes."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BODY_BYTES = 4096
_SAFE = frozenset({"GET", "HEAD"})
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}


class AccessControl:
    """Middleware in front of the application.

    An attacker can let a foreign host name point to this computer, so that his page can send requests to it (DNS rebinding). Therefore
    IP addresses are accepted, and host names only if they are registered.

    Args:
        app: the protected application.
        names: additional valid host names, besides localhost and the name of this computer.
    """

    def __init__(self, app: ASGIApp, names: Iterable[str] = ()) -> None:
        self._app = app
        self._names = {"localhost", socket.gethostname().lower(), *(name.lower() for name in names)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Process one request."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *((name.encode(), value.encode()) for name, value in _HEADERS.items())]
            await send(message)

        refusal = self._refusal(scope["method"], headers)
        await (self._app if refusal is None else refusal)(scope, receive, sent)

    def _refusal(self, method: str, headers: Headers) -> PlainTextResponse | None:
        host = headers.get("host", "")
        if not self._is_valid_host(host):
            return PlainTextResponse(f"{host[:100]}: not a name of this computer; give it with --page-name", 421)
        if method in _SAFE:
            return None
        if headers.get("origin", "") not in (f"http://{host}", f"https://{host}"):
            return PlainTextResponse("only a page of this server may send this request", 403)
        if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            return PlainTextResponse("the request must be JSON", 415)
        length = headers.get("content-length", "")
        if not length.isdecimal():
            return PlainTextResponse("the header content-length is missing", 411)
        return None if int(length) <= MAX_BODY_BYTES else PlainTextResponse("the request is too long", 413)

    def _is_valid_host(self, host: str) -> bool:
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdecimal() and not host.endswith("]") else host
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name.lower() in self._names
        return True
