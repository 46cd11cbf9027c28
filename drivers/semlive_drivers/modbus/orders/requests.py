"""Orders as Modbus requests, without IO: groups of registers and the numbers written to them."""

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


@dataclass(frozen=True, slots=True)
class Request:
    """One request that writes.

    Attributes:
        block: registers or coils.
        registers: one number for each of them.
        names: points in the block.
        single: use FC06 or FC05 instead of FC16 or FC15.
        verify: the map requires a read-back.
    """

    block: Block
    registers: tuple[int, ...]
    names: tuple[str, ...]
    single: bool = False
    verify: bool = False


def runs_of(points: Mapping[str, RegisterPoint], max_block: int = MAX_BLOCK) -> list[tuple[str, ...]]:
    """Groups of adjacent points of an order; each group is one request.

    Args:
        points: by name, in the order of the map's ``set``.
        max_block: largest number of registers in one request.

    Returns:
        Names by group, each group by address. Groups are sorted by the last of their points in the order of the map, so that the group
        with the command, which is last in a map, is written last.

    Raises:
        BadConfig: if two points overlap, or a group is too long for one request.
    """
    positions = {name: position for position, name in enumerate(points)}
    runs: list[list[str]] = []
    for name in sorted(points, key=lambda name: (points[name].kind, points[name].address)):
        point, before = points[name], points[runs[-1][-1]] if runs else None
        if before is not None and before.kind is point.kind and point.address < before.address + before.dtype.registers:
            raise BadConfig(f"{runs[-1][-1]} and {name} lie in the same register {point.address}; an order can write only one of them")
        adjacent = before is not None and before.kind is point.kind and point.address == before.address + before.dtype.registers
        runs[-1].append(name) if adjacent else runs.append([name])
    for run in runs:
        block_of((points[name] for name in run), max_block)
    return [tuple(run) for run in sorted(runs, key=lambda run: max(positions[name] for name in run))]


def blind_pdus(requests: Sequence[Request]) -> list[bytes]:
    """The requests of a stop as PDUs that are written without waiting for answers.

    A device that answers late executes them one after the other, so the last request, which holds the command, is written first as well.
    """
    pdus = [write_request(request.block.kind, request.block.address, request.registers, request.single) for request in requests]
    return [pdus[-1], *pdus] if len(pdus) > 1 else pdus


def points_with(write: Write, value: str) -> list[str]:
    """The points into which an entry of an order writes a value of this name, with either sign."""
    return [name for name, given in write.set.items() if isinstance(given, str) and given.removeprefix("-") == value]


def place_of(name: str, point: RegisterPoint) -> str:
    """A point and its address in a message: ``target (holding register 0)``."""
    return f"{name} ({point.kind.entry_name} {point.address})"


def requests_of(
    write: Write, points: Mapping[str, RegisterPoint], values: Mapping[str, float], max_block: int = MAX_BLOCK, *, exact: bool = True
) -> list[Request]:
    """The requests of one entry of an order, one for each group of adjacent registers; registers between the groups are not written.

    Args:
        write: the entry.
        points: of the device, by name.
        values: values of the order by name.
        max_block: largest number of registers in one request.
        exact: refuse values that the number format changes too much (`require_exact`); a stop is never refused for this reason.

    Raises:
        LinkError: if a value does not fit into its registers, or is refused.
    """
    requests = []
    for run in runs_of({name: points[name] for name in write.set}, max_block):
        block = block_of((points[name] for name in run), max_block)
        registers: list[int] = []
        for name in run:
            registers += encoded(name, points[name], write.set[name], values, exact=exact)
        requests.append(Request(block, tuple(registers), run, write.single, write.verify))
    return requests


def encoded(name: str, point: RegisterPoint, entry: float | str, values: Mapping[str, float], *, exact: bool = True) -> tuple[int, ...]:
    """The registers of one value of an order; arguments and errors as for `requests_of`."""
    value, quantity = number(entry, dict(values)), entry if isinstance(entry, str) else "constant"
    counts = (value - point.offset) / point.scale
    if is_rounded_down(quantity) and not point.dtype.is_float and math.isfinite(counts):
        registers = encode(point, towards_zero(counts) * point.scale + point.offset)
    else:
        registers = encode(point, value)
    if exact and point.dtype.is_float:
        require_exact(quantity, value, _float(point, registers), place_of(name, point), unit_of(quantity))
    elif exact:
        require_exact(quantity, value, decode(point, registers), place_of(name, point), unit_of(quantity))
    return registers


def _float(point: RegisterPoint, registers: Sequence[int]) -> float:
    """The value of an encoded float; 0 for a value too small for its format."""
    return decode(point, registers) if any(registers) else point.offset


@dataclass(frozen=True, slots=True)
class DescribedOrders:
    """Orders of a described device, as `semlive_drivers.device_part.OrderBook`; needs no link.

    Attributes:
        device: the description of the device.
        points: points of the device by name, with the changes of the configuration.
    """

    device: DeviceMap
    points: Mapping[str, RegisterPoint]

    @property
    def can(self) -> frozenset[PartCommand]:
        """Orders that the device can take."""
        return frozenset(self.device.orders)

    def order_problem(self, order: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why an order cannot be given exactly, or None."""
        all_values = {**dict.fromkeys(ORDERED, 0.0), **values}
        try:
            for write in self.device.orders.get(order, ()):
                requests_of(write, self.points, all_values, self.device.max_block)
        except LinkError as error:
            return str(error)
        return None

    def step_of(self, value: str) -> float:
        """Smallest step of ``travel_mm`` or ``speed_mm_s`` in orders in tension; 0 where the number format sets none."""
        points = [self.points[name] for write in self.device.orders.get(PartCommand.JOG_TENSION, ()) for name in points_with(write, value)]
        return max((abs(point.scale) for point in points if not point.dtype.is_float), default=0.0)
