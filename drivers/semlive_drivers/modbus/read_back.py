"""What a device holds of the last order, beside what was written: pure decisions, the reading itself is the part's.

Only registers of values (target, rate, travel, speed) are compared, and those of commands where the map asks for a read-back
(``verify: true``), because many devices clear a command once it has acted. Registers that the map lists under ``changes_by_itself`` are
left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from semlive.errors import LinkError
from semlive_drivers.device_part import MOTIONS
from semlive_drivers.modbus.codec import Block, block_of, count_of, decode
from semlive_drivers.modbus.device_map import DeviceMap, Write
from semlive_drivers.modbus.orders import Request, place_of, runs_of
from semlive_drivers.modbus.registers import RegisterPoint
from semlive_drivers.order_exactness import unit_of

_VALUES = ("force_n", "rate_n_s", "travel_mm", "speed_mm_s")
_CLOSE = 0.01
"""Relative difference between a value that was written and the same value as a device keeps it."""

_CLEARED_VALUES = 2
"""Fewest values that must be 0 before that counts as a restart; a single target of 0 may be an order of another program."""

Registers = Mapping[str, Sequence[int]]


@dataclass(frozen=True, slots=True)
class Entry:
    """What was written to one point.

    Attributes:
        written: its registers.
        held: its registers as the device keeps them, after the first read-back; None before that.
    """

    written: tuple[int, ...]
    held: tuple[int, ...] | None = None


Memory = Mapping[str, Entry]
"""By point."""


@dataclass(frozen=True, slots=True)
class Comparable:
    """The points of a map that can be compared.

    Attributes:
        values: the name of the value by point, for its unit; points that orders of motion write values to.
        excluded: points that are never compared.
    """

    values: Mapping[str, str]
    excluded: frozenset[str]


def comparable(device: DeviceMap) -> Comparable:
    """The points of a map that can be compared."""
    values: dict[str, str] = {}
    excluded = set(device.changes_by_itself)
    for what, writes in device.orders.items():
        for name, given in (item for write in writes for item in write.set.items()):
            called = given.removeprefix("-") if isinstance(given, str) else ""
            if called in _VALUES and what in MOTIONS:
                values[name] = called
            elif called and called not in _VALUES:
                excluded.add(name)
    return Comparable({name: called for name, called in values.items() if name not in excluded}, frozenset(excluded))


def remembered(memory: Memory, which: Comparable, write: Write, request: Request, points: Mapping[str, RegisterPoint]) -> dict[str, Entry]:
    """The memory after a request was written; with ``verify`` it was read back as well."""
    after = dict(memory)
    for name in request.names:
        words = request.registers[request.block.slice(points[name])]
        after.pop(name, None)
        if name in which.values or (write.verify and name not in which.excluded):
            after[name] = Entry(words, words if write.verify else None)
    return after


def forgotten(memory: Memory, names: Iterable[str]) -> dict[str, Entry]:
    """The memory without some points, of which nobody knows what they hold."""
    gone = set(names)
    return {name: entry for name, entry in memory.items() if name not in gone}


def groups_of(
    names: Iterable[str], points: Mapping[str, RegisterPoint], max_block: int, *, together: bool
) -> list[tuple[tuple[str, ...], Block]]:
    """Points in groups that are read in one request each.

    Args:
        names: which.
        points: of the device.
        max_block: most registers in one request.
        together: registers between the points may be read along; without that, every group is without gaps.
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
    memory: Memory, which: Comparable, points: Mapping[str, RegisterPoint], read: Registers
) -> tuple[dict[str, Entry], str | None]:
    """Registers that were read back, beside what was written there.

    A device may keep a value differently (rounded to its own steps): the first read-back after an order may differ by 1 % or one count
    and is what later ones are compared with, exactly.

    Returns:
        The memory, and the first difference as part of a sentence: ``its target (holding register 0) holds 380 N, 300 N was written``.
    """
    after, difference = dict(memory), None
    for name in sorted(read, key=lambda name: name not in which.values):  # a target tells a person more than a command word
        words, entry = read[name], memory.get(name)
        if entry is None:
            continue
        now = tuple(words)
        if entry.held is None and (now == entry.written or _close(points[name], entry.written, now)):
            after[name] = replace(entry, held=now)
        elif now != entry.held and difference is None:
            difference = _sentence(name, which.values.get(name, ""), points[name], entry.held or entry.written, now)
    return after, difference


def cleared(memory: Memory, read: Registers) -> bool:
    """Whether a device lost its order: at least two values that were written there, and all of those that were read, are 0."""
    orders = {name: words for name, words in read.items() if name in memory and any(memory[name].written)}
    return len(orders) >= _CLEARED_VALUES and not any(any(words) for words in orders.values())


def differing(memory: Memory, read: Registers) -> frozenset[str]:
    """The points whose registers are other than the device held them after the order."""
    return frozenset(name for name, words in read.items() if name in memory and tuple(words) != memory[name].held)


def expected(memory: Memory, which: Comparable, write: Write, request: Request, points: Mapping[str, RegisterPoint]) -> dict[str, Entry]:
    """The memory with the values of a request that an earlier process wrote; a command may have been cleared since, so it is left out."""
    return remembered(memory, which, write.model_copy(update={"verify": False}), request, points)


def _close(point: RegisterPoint, written: Sequence[int], now: Sequence[int]) -> bool:
    try:
        meant, held = decode(point, written), decode(point, now)
    except LinkError:
        return False
    return abs(held - meant) <= max(_CLOSE * abs(meant), count_of(point)) and (held != 0 or meant == 0)


def _sentence(name: str, called: str, point: RegisterPoint, written: Sequence[int], now: Sequence[int]) -> str:
    unit = f" {unit_of(called)}" if called else ""
    return f"its {place_of(name, point)} holds {_shown(point, now)}{unit}, {_shown(point, written)}{unit} was written"


def _shown(point: RegisterPoint, words: Sequence[int]) -> str:
    try:
        return f"{decode(point, words):g}"
    except LinkError:
        return " ".join(f"{word:#06x}" for word in words)


@dataclass(frozen=True, slots=True)
class TargetWatch:
    """The device's own target by its word, which must not jump while an order to go to a load stands.

    A device may count its target from a drifting zero, and takes a moment to take an order over; slow changes and the first second are
    therefore no jump. After a stop, and in a fault, a device may set its target to the present load.

    Attributes:
        ordered_n: the load that was ordered; None after a stop.
        since_s: when, monotonic s.
        largest_n: the largest load ordered so far, N.
        seen_n: the target at the last reading; None before the order was taken over.
    """

    ordered_n: float | None = None
    since_s: float = 0.0
    largest_n: float = 0.0
    seen_n: float | None = None

    def after_order(self, force_n: float | None, now_s: float) -> TargetWatch:
        """A load was ordered, or a stop (None)."""
        return TargetWatch(force_n, now_s, max(self.largest_n, abs(force_n or 0.0)))

    def after_reading(self, target_n: float, now_s: float, count_n: float) -> tuple[TargetWatch, str | None]:
        """One reading later.

        Args:
            target_n: the device's target now.
            now_s: monotonic s.
            count_n: value of one count of the target.

        Returns:
            The watch, and the jump as part of a sentence, or None.
        """
        if self.ordered_n is None or now_s - self.since_s < _TAKEN_OVER_S:
            return self, None
        allowed_n = max(_JUMP * self.largest_n, 5.0 * count_n)
        before = self.ordered_n if self.seen_n is None else self.seen_n
        if allowed_n > 0 and abs(target_n - before) > (allowed_n if self.seen_n is not None else 5.0 * allowed_n):
            return self, f"its own target is {target_n:g} N, {self.ordered_n:g} N was ordered"
        return replace(self, seen_n=target_n), None


_JUMP = 0.02
"""A jump of the device's own target, as a part of the largest load ordered so far."""
_TAKEN_OVER_S = 1.0
