"""Comparison of the registers of a device with the last order: pure decisions, without IO.

Registers of values (target, rate, travel, speed) are compared. Registers of commands are compared only where the map requires a read-back
(``verify: true``), because many devices clear a command after they executed it. Registers that the map lists under
``changes_by_itself`` are not compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from semlive.errors import LinkError
from semlive_drivers.device_part import MOTIONS
from semlive_drivers.modbus.codec import Block, block_of, count_of, decode
from semlive_drivers.modbus.device_map import DeviceMap, Write
from semlive_drivers.modbus.orders.requests import Request, place_of, runs_of
from semlive_drivers.modbus.registers import RegisterPoint
from semlive_drivers.order_exactness import unit_of

_VALUES = ("force_n", "rate_n_s", "travel_mm", "speed_mm_s")
_TOLERANCE = 0.01
"""Largest relative difference between a written value and the same value as the device stores it."""

_MIN_CLEARED_VALUES = 2
"""Smallest number of values that are 0 after a restart; a single target of 0 may be an order of another program."""

Registers = Mapping[str, Sequence[int]]


@dataclass(frozen=True, slots=True)
class Entry:
    """The last order to one point.

    Attributes:
        written: registers that were written.
        held: registers as the device stores them, from the first read-back; None before it.
    """

    written: tuple[int, ...]
    held: tuple[int, ...] | None = None


Memory = Mapping[str, Entry]
"""Entries by point."""


@dataclass(frozen=True, slots=True)
class Comparable:
    """The points of a map that can be compared.

    Attributes:
        values: name of the value by point, for its unit; only points to which motions write values.
        excluded: points that are never compared.
    """

    values: Mapping[str, str]
    excluded: frozenset[str]


def comparable(device: DeviceMap) -> Comparable:
    """The points of a map that can be compared."""
    values: dict[str, str] = {}
    excluded = set(device.changes_by_itself)
    for order, writes in device.orders.items():
        for name, entry in (item for write in writes for item in write.set.items()):
            value = entry.removeprefix("-") if isinstance(entry, str) else ""
            if value in _VALUES and order in MOTIONS:
                values[name] = value
            elif value and value not in _VALUES:
                excluded.add(name)
    return Comparable({name: value for name, value in values.items() if name not in excluded}, frozenset(excluded))


def remembered(memory: Memory, scope: Comparable, write: Write, request: Request, points: Mapping[str, RegisterPoint]) -> dict[str, Entry]:
    """The memory after a request was written, and read back if it has ``verify``."""
    after = dict(memory)
    for name in request.names:
        registers = request.registers[request.block.slice(points[name])]
        after.pop(name, None)
        if name in scope.values or (write.verify and name not in scope.excluded):
            after[name] = Entry(registers, registers if write.verify else None)
    return after


def forgotten(memory: Memory, names: Iterable[str]) -> dict[str, Entry]:
    """The memory without points whose content is unknown."""
    removed = set(names)
    return {name: entry for name, entry in memory.items() if name not in removed}


def groups_of(
    names: Iterable[str], points: Mapping[str, RegisterPoint], max_block: int, *, together: bool
) -> list[tuple[tuple[str, ...], Block]]:
    """Groups of points, each of which is read in one request.

    Args:
        names: names of the points.
        points: points of the device by name.
        max_block: largest number of registers in one request.
        together: whether registers between the points may be read as well; otherwise every group is without gaps.
    """
    runs = runs_of({name: points[name] for name in names}, max_block)
    groups: list[tuple[str, ...]] = []
    for run in sorted(runs, key=lambda run: (points[run[0]].kind, points[run[0]].address)):
        wider = (*groups[-1], *run) if groups and together else ()
        if wider and points[wider[0]].kind is points[run[0]].kind and _span(wider, points) <= max_block:
            groups[-1] = wider
        else:
            groups.append(run)
    return [(group, block_of((points[name] for name in group), max_block)) for group in groups]


def _span(names: Sequence[str], points: Mapping[str, RegisterPoint]) -> int:
    first = min(points[name].address for name in names)
    return max(points[name].address + points[name].dtype.registers for name in names) - first


def compared(
    memory: Memory, scope: Comparable, points: Mapping[str, RegisterPoint], read: Registers
) -> tuple[dict[str, Entry], str | None]:
    """Compare registers that were read back with the last order.

    A device may round a value to its own steps. The first read-back after an order may therefore differ by 1 % or one count; later ones
    must be equal to it.

    Returns:
        The memory, and the first difference as part of a message: ``its target (holding register 0) holds 380 N, 300 N was written``.
    """
    after, difference = dict(memory), None
    for name in sorted(read, key=lambda name: name not in scope.values):  # a value in a message is clearer than a command code
        registers, entry = read[name], memory.get(name)
        if entry is None:
            continue
        now = tuple(registers)
        if entry.held is None and (now == entry.written or _close(points[name], entry.written, now)):
            after[name] = replace(entry, held=now)
        elif now != entry.held and difference is None:
            difference = _message(name, scope.values.get(name, ""), points[name], entry.held or entry.written, now)
    return after, difference


def cleared(memory: Memory, read: Registers) -> bool:
    """Whether a device lost its order: at least two nonzero values were written, and all of them that were read are 0."""
    orders = {name: registers for name, registers in read.items() if name in memory and any(memory[name].written)}
    return len(orders) >= _MIN_CLEARED_VALUES and not any(any(registers) for registers in orders.values())


def differing(memory: Memory, read: Registers) -> frozenset[str]:
    """The points whose registers differ from the first read-back after the order."""
    return frozenset(name for name, registers in read.items() if name in memory and tuple(registers) != memory[name].held)


def expected(memory: Memory, scope: Comparable, write: Write, request: Request, points: Mapping[str, RegisterPoint]) -> dict[str, Entry]:
    """The memory with the values of a request of an earlier process; commands are not compared, because they may be cleared since."""
    return remembered(memory, scope, write.model_copy(update={"verify": False}), request, points)


def _close(point: RegisterPoint, written: Sequence[int], now: Sequence[int]) -> bool:
    try:
        ordered, held = decode(point, written), decode(point, now)
    except LinkError:
        return False
    return abs(held - ordered) <= max(_TOLERANCE * abs(ordered), count_of(point)) and (held != 0 or ordered == 0)


def _message(name: str, value: str, point: RegisterPoint, written: Sequence[int], now: Sequence[int]) -> str:
    unit = f" {unit_of(value)}" if value else ""
    return f"its {place_of(name, point)} holds {_shown(point, now)}{unit}, {_shown(point, written)}{unit} was written"


def _shown(point: RegisterPoint, registers: Sequence[int]) -> str:
    try:
        return f"{decode(point, registers):g}"
    except LinkError:
        return " ".join(f"{register:#06x}" for register in registers)


@dataclass(frozen=True, slots=True)
class TargetWatch:
    """The target that the device reports, which must not jump between two orders.

    A device may count its target from a drifting zero, and needs some time to accept an order. Slow changes and the first second are
    therefore no jump. After a stop, and in a fault, a device may set its target to the present load.

    Attributes:
        ordered_n: load that was ordered, N; None after a stop.
        since_s: monotonic time of the order, s.
        largest_n: largest load ordered so far, N.
        reported_n: target at the last reading, N; None before the device accepted the order.
    """

    ordered_n: float | None = None
    since_s: float = 0.0
    largest_n: float = 0.0
    reported_n: float | None = None

    def after_order(self, force_n: float | None, now_s: float) -> TargetWatch:
        """The watch after an order to go to a load, N, or after a stop (None)."""
        return TargetWatch(force_n, now_s, max(self.largest_n, abs(force_n or 0.0)))

    def after_reading(self, target_n: float, now_s: float, count_n: float) -> tuple[TargetWatch, str | None]:
        """The watch after a reading.

        Args:
            target_n: target that the device reports, N.
            now_s: monotonic time, s.
            count_n: value of one count of the target, N.

        Returns:
            The watch, and the jump as part of a message, or None.
        """
        if self.ordered_n is None or now_s - self.since_s < _ACCEPTED_AFTER_S:
            return self, None
        allowed_n = max(_JUMP * self.largest_n, 5.0 * count_n)
        before = self.ordered_n if self.reported_n is None else self.reported_n
        if allowed_n > 0 and abs(target_n - before) > (allowed_n if self.reported_n is not None else 5.0 * allowed_n):
            return self, f"its own target is {target_n:g} N, {self.ordered_n:g} N was ordered"
        return replace(self, reported_n=target_n), None


_JUMP = 0.02
"""Smallest jump of the target in the device, relative to the largest load ordered so far."""
_ACCEPTED_AFTER_S = 1.0
"""Time in which a device accepts an order."""
