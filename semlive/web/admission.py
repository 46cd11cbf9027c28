"""Limits on the connections of the page server, which are counted when they are accepted, before anything is read.

The number of connections is bounded, and a new connection is always accepted: at the bound the connection with the longest inactivity is
closed. Therefore any number of other connections cannot block a request of the operator, and a connection whose request contains the
token of the run is never closed for another one.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from collections.abc import Callable
from enum import IntEnum

MAX_CONNECTIONS = 300
MAX_LOCAL_CONNECTIONS = 200
"""Limit for loopback addresses: all users of a tunnel or a proxy appear as this computer."""
MAX_CONNECTIONS_PER_ADDRESS = 48

Client = tuple[str, int]


class Stage(IntEnum):
    """Stage of a connection, in the order in which connections are closed."""

    ORDINARY = 0
    """No request yet, between two requests, or an unauthenticated request."""
    VIEWING = 1
    """A stream of changes; the number of streams has a separate limit."""
    AUTHENTICATED = 2
    """A request with the token of the run is being answered."""


def is_loopback(host: str) -> bool:
    """Whether an address belongs to the loopback interface."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


class Admission:
    """Open connections by client address and port; to be used by one thread only.

    Args:
        most: largest number of connections.
        most_from_this_computer: largest number from a loopback address.
        most_from_an_address: largest number from any other address.
    """

    def __init__(
        self,
        most: int = MAX_CONNECTIONS,
        most_from_this_computer: int = MAX_LOCAL_CONNECTIONS,
        most_from_an_address: int = MAX_CONNECTIONS_PER_ADDRESS,
    ) -> None:
        self._most, self._most_here, self._most_each = most, most_from_this_computer, most_from_an_address
        self._close: dict[Client, Callable[[], object]] = {}
        # In each stage, in the order in which connections entered it or began a request.
        self._stages: dict[Stage, dict[Client, None]] = {stage: {} for stage in Stage}
        self._of_address: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._close)

    def admit(self, client: Client, close: Callable[[], object]) -> None:
        """Register a new connection, and close others if there are too many.

        Args:
            client: address and port.
            close: function that closes the connection at once and raises no exception.
        """
        self._forget(client)
        self._close[client] = close
        self._stages[Stage.ORDINARY][client] = None
        self._of_address[client[0]] += 1
        most = self._most_here if is_loopback(client[0]) else self._most_each
        if self._of_address[client[0]] > most:
            self._evict(client[0])
        if len(self._close) > self._most:
            self._evict(None)

    def enter(self, client: Client, stage: Stage) -> None:
        """Set the stage of a connection, or renew it; a closed connection is ignored."""
        if client not in self._close:
            return
        for clients in self._stages.values():
            clients.pop(client, None)
        self._stages[stage][client] = None

    def release(self, client: Client) -> None:
        """Reset the stage after a request was answered; the connection is closed before those with a later request."""
        if client in self._close and client not in self._stages[Stage.ORDINARY]:
            self.enter(client, Stage.ORDINARY)

    def leave(self, client: Client, close: Callable[[], object]) -> None:
        """Unregister a lost connection; `close` distinguishes it from a later one with the same address and port."""
        if self._close.get(client) == close:
            self._forget(client)

    def _evict(self, host: str | None) -> None:
        """Close the connection with the longest inactivity in the lowest stage, among those of `host` if it is given."""
        for stage in (Stage.ORDINARY, Stage.VIEWING):
            idle = next((client for client in self._stages[stage] if host is None or client[0] == host), None)
            if idle is not None:
                close = self._close[idle]
                self._forget(idle)
                close()
                return

    def _forget(self, client: Client) -> None:
        if self._close.pop(client, None) is None:
            return
        for clients in self._stages.values():
            clients.pop(client, None)
        self._of_address[client[0]] -= 1
        if not self._of_address[client[0]]:
            del self._of_address[client[0]]
