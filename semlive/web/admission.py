"""Which connections the page's server keeps: counted when they are accepted, before anything is read from them.

The number of connections is bounded, and a new connection always gets a place: at the bound the one that has done nothing for the longest
time is closed in its favour. So connections of others, however many, cannot keep a request of the operator away; and a connection whose
request has shown the run's token is never closed for another one.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from collections.abc import Callable
from enum import IntEnum

MOST = 300
MOST_FROM_THIS_COMPUTER = 200
"""A tunnel or a proxy shows all its users as this computer."""
MOST_FROM_AN_ADDRESS = 48

Client = tuple[str, int]


class Stage(IntEnum):
    """What a connection is doing, the first to be closed first."""

    ORDINARY = 0
    """Nothing that has to be kept: silent, between two requests, or with a request that has not shown the token."""
    VIEWING = 1
    """A stream of changes; their number is bounded elsewhere."""
    AUTHENTICATED = 2
    """A request with the run's token is being answered."""


def is_loopback(host: str) -> bool:
    """Whether an address is one of this computer's loopback interface."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


class Admission:
    """The open connections, by client address and port; for one thread.

    Args:
        most: how many there may be.
        most_from_this_computer: how many of a loopback address.
        most_from_an_address: how many of any other address.
    """

    def __init__(
        self,
        most: int = MOST,
        most_from_this_computer: int = MOST_FROM_THIS_COMPUTER,
        most_from_an_address: int = MOST_FROM_AN_ADDRESS,
    ) -> None:
        self._most, self._most_here, self._most_each = most, most_from_this_computer, most_from_an_address
        self._close: dict[Client, Callable[[], object]] = {}
        # In each stage, first those that entered it or began a request longest ago.
        self._stages: dict[Stage, dict[Client, None]] = {stage: {} for stage in Stage}
        self._of_address: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._close)

    def admit(self, client: Client, close: Callable[[], object]) -> None:
        """Take a new connection, and close others if there are too many.

        Args:
            client: address and port.
            close: closes it at once; must not raise.
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
        """A connection enters a stage, or enters its present stage again; one that was closed meanwhile is ignored."""
        if client not in self._close:
            return
        for clients in self._stages.values():
            clients.pop(client, None)
        self._stages[stage][client] = None

    def release(self, client: Client) -> None:
        """A request was answered: its connection is ordinary again, and closed before one that began a request later."""
        if client in self._close and client not in self._stages[Stage.ORDINARY]:
            self.enter(client, Stage.ORDINARY)

    def leave(self, client: Client, close: Callable[[], object]) -> None:
        """A connection was lost; `close` tells it from a later one of the same address and port."""
        if self._close.get(client) == close:
            self._forget(client)

    def _evict(self, host: str | None) -> None:
        """Close one connection, of one address if `host` is given: of the lowest stage that has any, the one that did nothing longest."""
        for stage in (Stage.ORDINARY, Stage.VIEWING):
            found = next((client for client in self._stages[stage] if host is None or client[0] == host), None)
            if found is not None:
                close = self._close[found]
                self._forget(found)
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
