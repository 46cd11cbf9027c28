"""Orders to one device: write them, read them back, and detect that the device holds others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from semlive.errors import LinkError
from semlive_drivers.device_part import FOREIGN_ORDER, MOTIONS, PartCommand
from semlive_drivers.maps import require_confirmed
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.device_map import DeviceMap, Write
from semlive_drivers.modbus.link import Link, Refused, write_verified
from semlive_drivers.modbus.orders.read_back import (
    Memory,
    cleared,
    comparable,
    compared,
    differing,
    expected,
    forgotten,
    groups_of,
    remembered,
)
from semlive_drivers.modbus.orders.requests import Request, blind_pdus, requests_of, runs_of
from semlive_drivers.modbus.registers import RegisterPoint
from semlive_drivers.modbus.settings import PartSettings

_CLEARED = "its registers were cleared, so it was restarted; check its zero, position and settings"
_MOTION_VALUES = ("force_n", "rate_n_s", "travel_mm", "speed_mm_s")


class Commander:
    """Orders of one device over one link.

    Args:
        link: open.
        device: the description of the device.
        points: points of the device by name, with the changes of the configuration.
        settings: of the part.
        read: reads a block, with one attempt to recover the link.
        nonce: number before that of the first order.

    Raises:
        BadConfig: if an order of the description cannot be written.
    """

    def __init__(
        self,
        link: Link,
        device: DeviceMap,
        points: Mapping[str, RegisterPoint],
        settings: PartSettings,
        read: Callable[[Block], tuple[int, ...]],
        nonce: int,
    ) -> None:
        self._link, self._device, self._points, self._settings, self._read = link, device, points, settings, read
        self._nonce = nonce
        # A stop repeats the last target: a target of zero would remain in the device until the next spurious start command.
        self._last: dict[str, float] = dict.fromkeys(_MOTION_VALUES, 0.0)
        self._comparable = comparable(device)
        self._memory: Memory = {}
        self._unreadable: set[str] = set()
        self._together = True
        self._next_group = 0
        self._read_back: set[PartCommand] = set()
        self._differing = frozenset[str]()
        self.cleared = False
        for writes in (*device.orders.values(), *(stop.writes for stop in device.other_stops)):
            for write in writes:
                runs_of({name: points[name] for name in write.set}, device.max_block)

    def give(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; return after the device took it, and after it was read back where its registers can be read.

        Raises:
            LinkError: if the device did not take it or cannot hold it exactly, or if it is a motion and the description is not confirmed.
        """
        if order in MOTIONS:
            confirmed = self._device.confirmed or self._settings.confirmed
            require_confirmed(self._link.where, self._device.name, confirmed=confirmed)
        # Everything is encoded and checked before anything is written.
        entries = self._entries(self._device.orders[order], values, exact=order is not PartCommand.STOP)
        self._last.update(values)
        differing, self._differing, self.cleared = self._differing, frozenset(), False
        if order is PartCommand.STOP:
            # A value that another program wrote, and that the stop does not write again, is not compared any more.
            self._memory = forgotten(self._memory, differing)
            self._write_all(entries)
            return
        for write, requests in entries:
            for request in requests:
                self._write(write, request)
        if order in MOTIONS:
            self._read_back_order(order, entries)

    def stop_blind(self) -> bool:
        """Write a stop without waiting for an answer; never raises."""
        entries = self._entries(self._device.orders.get(PartCommand.STOP, ()), {}, exact=False)
        pdus = [pdu for _, requests in entries for pdu in blind_pdus(requests)]
        return bool(pdus) and self._link.write_without_reply(pdus)

    def stop_by(self, method: int) -> None:
        """Stop by the further method of this index; raises LinkError if the device did not take it."""
        self._write_all(self._entries(self._device.other_stops[method].writes, {}, exact=False))

    def recall(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order of an earlier process, which may have sent a stop after it; writes nothing.

        A value that a stop writes differently is not compared. An order that cannot be encoded is not compared.
        """
        try:
            entries = self._entries(self._device.orders.get(order, ()), values, exact=False)
            self._last.update(values)
            stops = self._entries(self._device.orders.get(PartCommand.STOP, ()), {}, exact=False)
        except LinkError:
            return
        memory = self._expected(entries)
        after_stop = self._expected(stops)
        self._memory = forgotten(memory, (name for name, entry in after_stop.items() if name in memory and entry != memory[name]))

    def _expected(self, entries: Sequence[tuple[Write, Sequence[Request]]]) -> Memory:
        memory: Memory = {}
        for write, requests in entries:
            for request in requests:
                memory = expected(memory, self._comparable, write, request, self._points)
        return memory

    def difference(self) -> str | None:
        """How the registers of the device differ from the last order, as a message, or None; reads at most one block.

        Raises:
            LinkError: if the device does not answer.
        """
        names = [name for name in self._memory if name not in self._unreadable]
        if not names:
            return None
        groups = groups_of(names, self._points, self._device.max_block, together=self._together)
        self._next_group = (self._next_group + 1) % len(groups)
        difference = self._compare(*groups[self._next_group])
        return None if difference is None else f"{difference}: {_CLEARED if self.cleared else FOREIGN_ORDER}"

    def _read_back_order(self, order: PartCommand, entries: Sequence[tuple[Write, Sequence[Request]]]) -> None:
        """Read an order back once. Later jogs of a ramp in displacement control are compared with the next reading only."""
        names = {name for _, requests in entries for request in requests for name in request.names}
        unverified = [name for name, entry in self._memory.items() if name in names - self._unreadable and entry.held is None]
        if not unverified or (order is not PartCommand.RAMP and order in self._read_back):
            return
        self._read_back.add(order)
        for group, block in groups_of(unverified, self._points, self._device.max_block, together=self._together):
            difference = self._compare(group, block)
            if difference is not None:
                raise LinkError(
                    f"{self._link.where} did not take the command: {difference}; check the device's limits and who else commands it"
                )

    def _compare(self, names: Sequence[str], block: Block) -> str | None:
        try:
            registers = self._read(block)
        except Refused as refused:
            if not refused.is_final:
                raise
            # Registers between the points may not exist: then each group is read separately, and unreadable points are not compared.
            runs = groups_of(names, self._points, self._device.max_block, together=False)
            if len(runs) > 1:
                self._together = False
            else:
                self._unreadable |= set(names)
            return None
        read = {name: registers[block.slice(self._points[name])] for name in names}
        self._memory, difference = compared(self._memory, self._comparable, self._points, read)
        if difference is not None:
            self._differing |= differing(self._memory, read)
            self.cleared = cleared(self._memory, read)
        return difference

    def _entries(self, writes: Sequence[Write], values: Mapping[str, float], *, exact: bool) -> list[tuple[Write, Sequence[Request]]]:
        """The requests of an order by entry; raises LinkError if the device cannot hold a value (exactly enough, with `exact`)."""
        self._nonce = (self._nonce + 1) % 65_536
        all_values = {**self._last, **values, "nonce": float(self._nonce), "watchdog_s": self._settings.watchdog_s}
        max_block = self._device.max_block
        return [(write, requests_of(write, self._points, all_values, max_block, exact=exact)) for write in writes]

    def _write(self, write: Write, request: Request) -> None:
        self._memory = forgotten(self._memory, request.names)  # after a failure the content of the registers is unknown
        if request.verify:
            write_verified(self._link, request.block, request.registers, single=request.single)
        else:
            self._link.write(request.block.address, request.registers, request.block.kind, single=request.single)
        self._memory = remembered(self._memory, self._comparable, write, request, self._points)

    def _write_all(self, entries: Sequence[tuple[Write, Sequence[Request]]]) -> None:
        """Write every request of a stop, also after a failed one, because a later one may hold the command."""
        failures = []
        for write, requests in entries:
            for request in requests:
                try:
                    self._write(write, request)
                except LinkError as error:
                    failures.append(error)
        if failures:
            raise failures[0]
