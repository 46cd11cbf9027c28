"""Read requests to a device that refuses some of them, is busy, answers late, or cuts the connection."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from semlive.errors import LinkError, LinkRefused
from semlive_drivers.modbus.checking.refusals import GATEWAY, PASSING
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.link import Link, Refused
from semlive_drivers.modbus.registers import Kind

Register = tuple[Kind, int]
"""Table and address."""

_BUSY_TRIES = 3
_BUSY_WAIT_S = 0.2
_MAX_LOST = 6
"""Lost replies after which only the points of the description are still read."""
_FRESH_AFTER = 2
"""Lost replies after which every request has a connection of its own: an answer to an earlier request cannot arrive there."""
_BLOCK = 32
"""Most registers in one request of a search."""


class Reader:
    """Reads one device; after a lost reply it opens the link again and continues.

    Args:
        open_link: opens the link; raises LinkError.
        max_block: largest number of registers in one request.

    Raises:
        LinkRefused: if no link can be opened.
    """

    def __init__(self, open_link: Callable[[], Link], max_block: int) -> None:
        self._open = open_link
        self._block = min(max_block, _BLOCK)
        self._link: Link | None = open_link()
        self._shut: set[Kind] = set()
        self.where = self._link.where
        self.lost: list[str] = []
        self.answered = False
        self._reopened = 0

    def read(self, block: Block) -> tuple[int, ...]:
        """Read a block.

        Raises:
            Refused: if the device answers with an exception.
            LinkError: if no valid answer comes, also on a new connection.
        """
        for tried in range(_BUSY_TRIES):
            try:
                return self._read_again(block)
            except Refused as error:
                if error.code not in PASSING or tried == _BUSY_TRIES - 1:
                    raise
                time.sleep(_BUSY_WAIT_S)
        raise AssertionError("unreachable")

    def search(self, addresses: Iterable[Register]) -> dict[Register, int]:
        """The registers of those addresses that the device has; blocks that it refuses are divided."""
        found: dict[Register, int] = {}
        needed = set(addresses)
        for kind in Kind:
            for block in _blocks(kind, sorted(address for other, address in needed if other is kind), self._block):
                self._search(block, found)
        return found

    def close(self) -> None:
        """Close the link; never raises."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def _search(self, block: Block, found: dict[Register, int]) -> None:
        if block.kind in self._shut or len(self.lost) >= _MAX_LOST:
            return
        try:
            values = self.read(block)
        except Refused as error:
            if error.code in (1, *GATEWAY, *PASSING):
                self._shut.add(block.kind)
            elif block.count > 1:
                half = block.count // 2
                self._search(Block(block.kind, block.address, half), found)
                self._search(Block(block.kind, block.address + half, block.count - half), found)
            return
        except LinkError:
            return
        found |= {(block.kind, block.address + index): value for index, value in enumerate(values)}

    def _read_again(self, block: Block) -> tuple[int, ...]:
        """Read, and a second time on a new connection after a lost reply."""
        if self._reopened >= _FRESH_AFTER and self.answered:
            self._renew()
        try:
            return self._once(block)
        except Refused:
            raise
        except LinkError as error:
            self.lost.append(str(error))
            if not (self._link is not None and self._link.resync()):
                self._reopened += 1
                self._renew()
            return self._once(block)

    def _once(self, block: Block) -> tuple[int, ...]:
        if self._link is None:
            self._link = self._open()
        try:
            values = self._link.read(block)
        except Refused:
            self.answered = True
            raise
        self.answered = True
        return values

    def _renew(self) -> None:
        self.close()
        try:
            self._link = self._open()
        except LinkRefused:
            raise
        except LinkError as error:
            raise LinkRefused(str(error)) from error


def _blocks(kind: Kind, addresses: list[int], most: int) -> Iterable[Block]:
    """Blocks of adjacent addresses."""
    first: int | None = None
    last = 0
    for address in addresses:
        if first is not None and (address > last + 1 or address - first >= most):
            yield Block(kind, first, last - first + 1)
            first = None
        if first is None:
            first = address
        last = address
    if first is not None:
        yield Block(kind, first, last - first + 1)
