"""Connection of the page server: that of uvicorn with a limited number of connections and a time limit for request headers."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

from semlive.web.admission import Admission, Client, Stage

HEAD_S = 5.0


class BoundedProtocol(H11Protocol):
    """HTTP protocol for uvicorn; `bounded` creates the class for one server.

    Attributes:
        admission: the open connections of the server.
    """

    admission: Admission
    _place: Client | None = None
    _head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Register the connection before anything is read."""
        super().connection_made(transport)
        self._place = self.client
        if self._place is None:
            transport.abort()
            return
        self._await_head()
        self.admission.admit(self._place, self._drop)

    def data_received(self, data: bytes) -> None:
        """Process received bytes; an incomplete request must be completed within the time limit."""
        before = self.cycle
        super().data_received(data)
        if self._place is None or self.transport.is_closing():
            return
        if self.cycle is not before:
            self._head_came()
            self.admission.enter(self._place, Stage.ORDINARY)
        elif before is None or before.response_complete:
            self._await_head()

    def on_response_complete(self) -> None:
        """A request was answered; uvicorn waits for the next one, and closes the connection if none begins in time.

        A part of the next one that came with the request that was answered has to become whole in time as well.
        """
        super().on_response_complete()
        if self._place is None:
            return
        self.admission.release(self._place)
        begun, _ = self.conn.trailing_data
        if begun and self.cycle.response_complete and not self.transport.is_closing():
            self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Unregister the connection."""
        self._head_came()
        if self._place is not None:
            self.admission.leave(self._place, self._drop)
        super().connection_lost(exc)

    def _await_head(self) -> None:
        if self._head_timer is None:
            self._head_timer = self.loop.call_later(HEAD_S, self._drop)

    def _head_came(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _drop(self) -> None:
        self.transport.abort()


def bounded(admission: Admission) -> type[BoundedProtocol]:
    """Return the connection class for one server."""
    return type("Bounded", (BoundedProtocol,), {"admission": admission})
