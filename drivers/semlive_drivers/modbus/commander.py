"""Gives a device its orders, reads them back, and notices when the device holds others than were given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from semlive.errors import LinkError
from semlive_drivers.device_part import MOTIONS, PartCommand
from semlive_drivers.maps import UNCONFIRMED_NOTE
from semlive_drivers.modbus.client import Link, Refused, write_verified
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.device_map import DeviceMap, Write
from semlive_drivers.modbus.orders import Request, blind_pdus, requests_of, runs_of
from semlive_drivers.modbus.read_back import Memory, cleared, comparable, compared, differing, expected, forgotten, groups_of, remembered
from semlive_drivers.modbus.registers import RegisterPoint
from semlive_drivers.modbus.settings import PartSettings

_FOREIGN = "another program or a person commands it, or it was restarted"
_CLEARED = "its registers were cleared, so it was restarted; check its zero, position and settings"
_MOVED = ("force_n", "rate_n_s", "travel_mm", "speed_mm_s")


class Commander:
    """Orders of one device over one link.

    Args:
        link: open.
        device: its description.
        points: of the device, as they are here.
        settings: of the part.
        read: reads a block, with one attempt to recover the link.
        nonce: where the numbers of orders begin.

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
        # A stop repeats the last target: a target of zero would wait in the device for the next spurious "go".
        self._last: dict[str, float] = dict.fromkeys(_MOVED, 0.0)
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

    def give(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; returns when it was taken, and read back where the registers can be read.

        Raises:
            LinkError: if the device did not take it, or could not take it as it is meant, or the description is not confirmed.
        """
        if what in MOTIONS and not (self._device.confirmed or self._settings.confirmed):
            raise LinkError(
                f"{self._link.where}: the description of {self._device.name} is {UNCONFIRMED_NOTE}; "
                "check it with `semlive frame check`, move the machine by its own panel and watch the values, then set confirmed: true"
            )
        # Everything is encoded and checked before anything is written.
        entries = self._entries(self._device.orders[what], values, exact=what is not PartCommand.STOP)
        self._last.update(values)
        differing, self._differing, self.cleared = self._differing, frozenset(), False
        if what is PartCommand.STOP:
            # A value that another program wrote and the stop does not write again is no order of semlive any more.
            self._memory = forgotten(self._memory, differing)
            self._write_all(entries)
            return
        for write, requests in entries:
            for request in requests:
                self._write(write, request)
        if what in MOTIONS:
            self._read_back_order(what, entries)

    def stop_blind(self) -> bool:
        """Write a stop without waiting for an answer; never raises."""
        entries = self._entries(self._device.orders.get(PartCommand.STOP, ()), {}, exact=False)
        pdus = [pdu for _, requests in entries for pdu in blind_pdus(requests)]
        return bool(pdus) and self._link.write_without_reply(pdus)

    def stop_by(self, method: int) -> None:
        """Write the further stop of this index; raises LinkError if the device did not take it."""
        self._write_all(self._entries(self._device.other_stops[method].writes, {}, exact=False))

    def recall(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order of an earlier process, which may have sent a stop after it; writes nothing.

        A value that a stop writes differently is not compared. An order that cannot be encoded is not compared.
        """
        try:
            entries = self._entries(self._device.orders.get(what, ()), values, exact=False)
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
        """How the device's registers differ from what was written last, as a sentence, or None; reads at most one block.

        Raises:
            LinkError: if the device does not answer.
        """
        names = [name for name in self._memory if name not in self._unreadable]
        if not names:
            return None
        groups = groups_of(names, self._points, self._device.max_block, together=self._together)
        self._next_group = (self._next_group + 1) % len(groups)
        found = self._compare(*groups[self._next_group])
        return None if found is None else f"{found}: {_CLEARED if self.cleared else _FOREIGN}"

    def _read_back_order(self, what: PartCommand, entries: Sequence[tuple[Write, Sequence[Request]]]) -> None:
        """Read an order back once; a way of a ramp that was read back before is looked at with the next reading only."""
        names = {name for _, requests in entries for request in requests for name in request.names}
        unsure = [name for name, entry in self._memory.items() if name in names - self._unreadable and entry.held is None]
        if not unsure or (what is not PartCommand.RAMP and what in self._read_back):
            return
        self._read_back.add(what)
        for group, block in groups_of(unsure, self._points, self._device.max_block, together=self._together):
            found = self._compare(group, block)
            if found is not None:
                raise LinkError(f"{self._link.where} did not take the command: {found}; check the device's limits and who else commands it")

    def _compare(self, names: Sequence[str], block: Block) -> str | None:
        try:
            words = self._read(block)
        except Refused as refused:
            if not refused.is_final:
                raise
            # Registers between the points may not exist; then each group is read for itself, and what cannot be read is left out.
            runs = groups_of(names, self._points, self._device.max_block, together=False)
            if len(runs) > 1:
                self._together = False
            else:
                self._unreadable |= set(names)
            return None
        read = {name: words[block.slice(self._points[name])] for name in names}
        self._memory, found = compared(self._memory, self._comparable, self._points, read)
        if found is not None:
            self._differing |= differing(self._memory, read)
            self.cleared = cleared(self._memory, read)
        return found

    def _entries(self, writes: Sequence[Write], values: Mapping[str, float], *, exact: bool) -> list[tuple[Write, Sequence[Request]]]:
        """The requests of an order, by entry; raises LinkError where the device would not take what is meant."""
        self._nonce = (self._nonce + 1) % 65_536
        known = {**self._last, **values, "nonce": float(self._nonce), "watchdog_s": self._settings.watchdog_s}
        most = self._device.max_block
        return [(write, requests_of(write, self._points, known, most, exact=exact)) for write in writes]

    def _write(self, write: Write, request: Request) -> None:
        self._memory = forgotten(self._memory, request.names)  # an order that fails leaves nobody knows what
        if request.verify:
            write_verified(self._link, request.block, request.registers, single=request.single)
        else:
            self._link.write(request.block.address, request.registers, request.block.kind, single=request.single)
        self._memory = remembered(self._memory, self._comparable, write, request, self._points)

    def _write_all(self, entries: Sequence[tuple[Write, Sequence[Request]]]) -> None:
        """Write every request of a stop, also after one that failed: the command may be in a later one."""
        failures = []
        for write, requests in entries:
            for request in requests:
                try:
                    self._write(write, request)
                except LinkError as error:
                    failures.append(error)
        if failures:
            raise failures[0]
