"""Connection of the page server: that of uvicorn with a limited number of connections and a time limit for request headers."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

from semlive.web.admission import Admission, Client, Stage

HEADER_TIMEOUT_S = 5.0


class BoundedProtocol(H11Protocol):
    """HTTP protocol for uvicorn; `bounded` creates the class for one server.

    Attributes:
        admission: the open connections of the server.
    """

    admission: Admission
    _client: Client | None = None
    _head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Register the connection before anything is read."""
        super().connection_made(transport)
        self._client = self.client
        if self._client is None:
            transport.abort()
            return
        self._start_head_timer()
        self.admission.admit(self._client, self._drop)

    def data_received(self, data: bytes) -> None:
        """Process received bytes; an incomplete request must be completed within the time limit."""
        before = self.cycle
        super().data_received(data)
        if self._client is None or self.transport.is_closing():
            return
        if self.cycle is not before:
            self._stop_head_timer()
            self.admission.enter(self._client, Stage.ORDINARY)
        elif before is None or before.response_complete:
            self._start_head_timer()

    def on_response_complete(self) -> None:
        """Wait for the next request; uvicorn closes the connection if none begins in time.

        If the beginning of the next request has already arrived, that request must be completed within the time limit, too.
        """
        super().on_response_complete()
        if self._client is None:
            return
        self.admission.release(self._client)
        received, _ = self.conn.trailing_data
        if received and self.cycle.response_complete and not self.transport.is_closing():
            self._start_head_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Unregister the connection."""
        self._stop_head_timer()
        if self._client is not None:
            self.admission.leave(self._client, self._drop)
        super().connection_lost(exc)

    def _start_head_timer(self) -> None:
        if self._head_timer is None:
            self._head_timer = self.loop.call_later(HEADER_TIMEOUT_S, self._drop)

    def _stop_head_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _drop(self) -> None:
        self.transport.abort()


def bounded(admission: Admission) -> type[BoundedProtocol]:
    """Return the connection class for one server."""
    return type("Bounded", (BoundedProtocol,), {"admission": admission})
