"""Orders as requests, without IO: which registers are written together, and with which numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from semlive.errors import BadConfig, LinkError
from semlive_drivers.device_part import PartCommand
from semlive_drivers.modbus.codec import Block, block_of, decode, encode
from semlive_drivers.modbus.device_map import ORDERED, DeviceMap, Write, number
from semlive_drivers.modbus.registers import MAX_BLOCK, RegisterPoint
from semlive_drivers.modbus.rtu.frames import write_request
from semlive_drivers.order_exactness import is_rounded_down, require_exact, towards_zero, unit_of

_WORDS = {"holding": "holding register", "coil": "coil", "input": "input register", "discrete": "discrete input"}


@dataclass(frozen=True, slots=True)
class Request:
    """One request that writes.

    Attributes:
        block: which registers, or coils.
        registers: what is written there, one number for each.
        names: the points that lie in the block.
        single: FC06 or FC05 in place of FC16 or FC15.
        verify: the map asks for a read-back.
    """

    block: Block
    registers: tuple[int, ...]
    names: tuple[str, ...]
    single: bool = False
    verify: bool = False


def runs_of(points: Mapping[str, RegisterPoint], max_block: int = MAX_BLOCK) -> list[tuple[str, ...]]:
    """The points of an order in groups without a gap, each of which is one request.

    Args:
        points: by name, in the order of the map's ``set``.
        max_block: most registers that the device takes at once.

    Returns:
        Names by group, each group by address. A group follows all groups whose points were named before its last one, so that the group
        with the command, which a map names last, is written last.

    Raises:
        BadConfig: if two points overlap, or a group is too long for one request.
    """
    listed = {name: place for place, name in enumerate(points)}
    runs: list[list[str]] = []
    for name in sorted(points, key=lambda name: (points[name].kind, points[name].address)):
        point, before = points[name], points[runs[-1][-1]] if runs else None
        if before is not None and before.kind is point.kind and point.address < before.address + before.dtype.registers:
            raise BadConfig(f"{runs[-1][-1]} and {name} lie in the same register {point.address}; an order can write only one of them")
        adjacent = before is not None and before.kind is point.kind and point.address == before.address + before.dtype.registers
        runs[-1].append(name) if adjacent else runs.append([name])
    for run in runs:
        block_of((points[name] for name in run), max_block)
    return [tuple(run) for run in sorted(runs, key=lambda run: max(listed[name] for name in run))]


def blind_pdus(requests: Sequence[Request]) -> list[bytes]:
    """The requests of a stop as PDUs to write without waiting for answers.

    A device that answers late works on them one after the other, so the last request, which has the command, is written first as well.
    """
    pdus = [write_request(request.block.kind, request.block.address, request.registers, request.single) for request in requests]
    return [pdus[-1], *pdus] if len(pdus) > 1 else pdus


def named(write: Write, value: str) -> list[str]:
    """The points into which an entry of an order writes a value of this name, turned or not."""
    return [name for name, given in write.set.items() if isinstance(given, str) and given.removeprefix("-") == value]


def place_of(name: str, point: RegisterPoint) -> str:
    """A point and its address, for a person."""
    return f"{name} ({_WORDS[point.kind.value]} {point.address})"


def requests_of(
    write: Write, points: Mapping[str, RegisterPoint], values: Mapping[str, float], max_block: int = MAX_BLOCK, *, exact: bool = True
) -> list[Request]:
    """The requests of one entry of an order: one for each group of adjacent registers, none of which the map does not name.

    Args:
        write: the entry.
        points: of the device, by name.
        values: what the order's names stand for.
        max_block: most registers that the device takes at once.
        exact: refuse values that the device would not take as they were meant (`require_exact`); a stop is never refused for that.

    Raises:
        LinkError: if a value does not fit, or is refused.
    """
    requests = []
    for run in runs_of({name: points[name] for name in write.set}, max_block):
        block = block_of((points[name] for name in run), max_block)
        registers: list[int] = []
        for name in run:
            registers += encoded(name, points[name], write.set[name], values, exact=exact)
        requests.append(Request(block, tuple(registers), run, write.single, write.verify))
    return requests


def encoded(name: str, point: RegisterPoint, given: float | str, values: Mapping[str, float], *, exact: bool = True) -> tuple[int, ...]:
    """The registers of one value of an order; arguments and errors as for `requests_of`."""
    value, called = number(given, dict(values)), given if isinstance(given, str) else "constant"
    counts = (value - point.offset) / point.scale
    if is_rounded_down(called) and not point.dtype.is_float and math.isfinite(counts):
        registers = encode(point, towards_zero(counts) * point.scale + point.offset)
    else:
        registers = encode(point, value)
    if exact and point.dtype.is_float:
        require_exact(called, value, _float(point, registers), place_of(name, point), unit_of(called))
    elif exact:
        require_exact(called, value, decode(point, registers), place_of(name, point), unit_of(called))
    return registers


def _float(point: RegisterPoint, registers: Sequence[int]) -> float:
    """The value of a float that was encoded here; 0 for one too small for its format."""
    return decode(point, registers) if any(registers) else point.offset


@dataclass(frozen=True, slots=True)
class DescribedOrders:
    """What a described device can be ordered, as `semlive_drivers.device_part.OrderBook`; needs no link.

    Attributes:
        device: its description.
        points: of the device, as they are here.
    """

    device: DeviceMap
    points: Mapping[str, RegisterPoint]

    @property
    def can(self) -> frozenset[PartCommand]:
        """What the device can be told."""
        return frozenset(self.device.orders)

    def order_problem(self, what: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why an order cannot be given as it is meant, or None."""
        known = {**dict.fromkeys(ORDERED, 0.0), **values}
        try:
            for write in self.device.orders.get(what, ()):
                requests_of(write, self.points, known, self.device.max_block)
        except LinkError as error:
            return str(error)
        return None

    def step_of(self, value: str) -> float:
        """Smallest step of ``travel_mm`` or ``speed_mm_s`` in orders to pull; 0 where the number format sets none."""
        points = [self.points[name] for write in self.device.orders.get(PartCommand.JOG_TENSION, ()) for name in named(write, value)]
        return max((abs(point.scale) for point in points if not point.dtype.is_float), default=0.0)
