"""Server of the page on which region and masks are drawn: this computer only, one frame, one answer."""

from __future__ import annotations

import contextlib
import hmac
import json
import math
import queue
import secrets
import threading
import time
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from semlive.cli.before_run.region.drawing import Drawing, FrameSize, Region, parse_drawing, shown_png
from semlive.errors import BadInput

_HOST = "127.0.0.1"
_MAX_BODY_BYTES = 2**20
_READ_TIMEOUT_S = 10.0
_WAIT_S = 0.5
_STATIC = {"/": ("region.html", "text/html"), "/region.js": ("region.js", "text/javascript"), "/region.css": ("region.css", "text/css")}
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "cache-control": "no-store",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}


class RegionServer:
    """Server of one drawing; used in a `with` statement, at whose end it stops.

    The frame and the answer need the token, which is behind the ``#`` of the address and therefore in no request line.

    Args:
        image: (height, width) grey levels.
        size: size of the frame and of a subset.
        region: region of interest that is shown first.
    """

    def __init__(self, image: NDArray[np.uint8] | NDArray[np.uint16], size: FrameSize, region: Region) -> None:
        described = {"width": size.width_px, "height": size.height_px, "subset": size.subset_px, "region": region}
        content = {"/frame.json": (json.dumps(described).encode(), "application/json"), "/frame.png": (shown_png(image), "image/png")}
        self._server = _PageServer(size, content)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    @property
    def address(self) -> str:
        """Address of the page, with the token."""
        return f"http://{_HOST}:{self._server.server_address[1]}/#{self._server.token}"

    def __enter__(self) -> RegionServer:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def answer(self, timeout_s: float | None = None) -> Drawing | None:
        """Wait for the answer; None if the user keeps the region as it is.

        Raises:
            TimeoutError: there was no answer in this time.
        """
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        # Short waits: on Windows, a wait without end cannot be interrupted by Ctrl+C.
        while (remaining_s := deadline - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                return self._server.answers.get(timeout=min(remaining_s, _WAIT_S))
        raise TimeoutError("nothing was drawn")


class _PageServer(ThreadingHTTPServer):
    """Server with the token, the content and the answers of one page."""

    daemon_threads = True

    def __init__(self, size: FrameSize, content: Mapping[str, tuple[bytes, str]]) -> None:
        super().__init__((_HOST, 0), _Handler)
        self.size, self.content = size, content
        self.token = secrets.token_urlsafe(24)
        self.answers: queue.Queue[Drawing | None] = queue.Queue()


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: _PageServer  # pyright: ignore[reportIncompatibleVariableOverride]  (as the server makes it)
    timeout = _READ_TIMEOUT_S

    def do_GET(self) -> None:
        if self.path in _STATIC:
            if self._is_local():
                name, kind = _STATIC[self.path]
                self._send(200, files("semlive.cli.before_run.region").joinpath("static", name).read_bytes(), kind)
        elif self._may():
            data = self.server.content.get(self.path)
            self._send(*((404, b"", "text/plain") if data is None else (200, *data)))

    def do_POST(self) -> None:
        if not self._may():
            return
        length = self.headers.get("content-length", "")
        if not length.isdigit() or int(length) > _MAX_BODY_BYTES:
            self._send(413, b"the drawing is too large", "text/plain")
            return
        body = self.rfile.read(int(length))
        if self.path not in ("/keep", "/drawing"):
            self._send(404, b"", "text/plain")
            return
        try:
            drawing = None if self.path == "/keep" else parse_drawing(body, self.server.size)
        except BadInput as error:
            self._send(400, str(error).encode(), "text/plain")
            return
        # The page gets its answer first: the program may end as soon as it has the drawing.
        self._send(200, b"", "text/plain")
        self.server.answers.put(drawing)

    def _may(self) -> bool:
        """Whether the request is from this computer's page, with its token; the others are refused."""
        if not self._is_local():
            return False
        given = self.headers.get("authorization", "").removeprefix("Bearer ")
        if not hmac.compare_digest(given.encode(), self.server.token.encode()):
            self._send(403, b"the token is missing or wrong", "text/plain")
            return False
        return True

    def _is_local(self) -> bool:
        """Whether the request names this server: a foreign name that leads here belongs to another page (DNS rebinding)."""
        port = self.server.server_address[1]
        if self.headers.get("host", "") not in (f"{_HOST}:{port}", f"localhost:{port}"):
            self._send(421, b"not the name of this server", "text/plain")
            return False
        return True

    def _send(self, status: int, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in {**_HEADERS, "content-type": f"{kind}; charset=utf-8", "content-length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Write nothing to the terminal."""
