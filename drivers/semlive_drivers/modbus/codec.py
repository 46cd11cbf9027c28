"""Registers to values and back, without any IO."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from semlive.errors import BadConfig, LinkError
from semlive_drivers.modbus.registers import MAX_BLOCK, DType, Kind, RegisterPoint, WordOrder

_FORMATS = {
    **{DType.U16: ">H", DType.I16: ">h", DType.U32: ">I", DType.I32: ">i", DType.F32: ">f"},
    **{DType.U64: ">Q", DType.I64: ">q", DType.F64: ">d"},
}

_TINIEST = 2.0**-126
"""The smallest normal number of 32 bits; round numbers with their words swapped are smaller: 99.25 reads as 4.6e-41."""


@dataclass(frozen=True, slots=True)
class Block:
    """Registers that are read or written in one request.

    Attributes:
        kind: which table.
        address: first register.
        count: how many.
    """

    kind: Kind
    address: int
    count: int

    def slice(self, point: RegisterPoint) -> slice:
        """Where a point lies in the block's registers."""
        first = point.address - self.address
        return slice(first, first + point.dtype.registers)


def block_of(points: Iterable[RegisterPoint], max_block: int = MAX_BLOCK) -> Block:
    """The smallest block that holds all points.

    Args:
        points: at least one.
        max_block: most registers that the device gives or takes at once.

    Raises:
        BadConfig: if they lie in different tables or too far apart for one request.
    """
    points = tuple(points)
    kinds = {p.kind for p in points}
    if len(kinds) != 1:
        raise BadConfig("registers that are read together must all be input or all be holding registers; correct the register map")
    first = min(p.address for p in points)
    count = max(p.address + p.dtype.registers for p in points) - first
    if count > max_block:
        raise BadConfig(f"registers {first} to {first + count - 1} do not fit into one request of {max_block}; correct the register map")
    return Block(kinds.pop(), first, count)


def number_in(point: RegisterPoint, registers: Sequence[int]) -> float | int:
    """The bare number of a point, before sign, factors and scale."""
    ordered = registers if point.words is WordOrder.HIGH_FIRST else registers[::-1]
    raw = struct.pack(f"{'>' if point.byte_order is WordOrder.HIGH_FIRST else '<'}{len(ordered)}H", *ordered)
    (number,) = struct.unpack(_FORMATS[point.dtype], raw)
    if point.bit_count:
        return number >> point.first_bit & ((1 << point.bit_count) - 1)
    return number


def decode(point: RegisterPoint, registers: Sequence[int], others: Mapping[str, Sequence[int]] | None = None) -> float:
    """The value of a point from its own registers.

    Args:
        point: which.
        registers: its own, as read.
        others: registers of the points that say its sign and size, by name.

    Raises:
        LinkError: if it is not a finite number, or says that there is no reading.
    """
    number = number_in(point, registers)
    value = number * point.scale
    if not math.isfinite(value) or number in point.sentinels:
        raise LinkError(f"register {point.address} holds {number}, which is no reading; check the sensor and the register map")
    if point.dtype.is_float and 0 < abs(number) < _TINIEST:
        raise LinkError(f"register {point.address} holds {number:g}, which no device tells; check the order of words in the register map")
    if point.sign is not None or point.factors:
        value *= _told_by(point, others or {})
    return value + point.offset


def _told_by(point: RegisterPoint, others: Mapping[str, Sequence[int]]) -> float:
    """What other points say of the sign and the size of a number."""
    factor = -1.0 if point.sign is not None and point.sign.of(others[point.sign.point][0]) else 1.0
    for told in point.factors:
        said = told.bits.of(others[told.bits.point][0])
        if told.factors is None:
            factor *= 10.0**-said
            continue
        known = dict(told.factors)
        if said not in known:
            raise LinkError(
                f"{told.bits.point} says {said}, of which the register map does not tell what it means for register {point.address}; "
                "check the device's settings and the map"
            )
        factor *= known[said]
    return factor


def count_of(point: RegisterPoint, others: Mapping[str, Sequence[int]] | None = None) -> float:
    """Value of one count of a point, always positive; 0 for floats, whose number format sets no step.

    Args:
        point: which.
        others: registers of the points that say its sign and size, by name.

    Raises:
        LinkError: if these say something that the map does not know.
    """
    return 0.0 if point.dtype.is_float else abs(point.scale * _told_by(point, others or {}))


def require_in_range(name: str, point: RegisterPoint, registers: Sequence[int], value: float, *, unsigned: bool) -> None:
    """Refuse a reading at the end of what its number or its sensor can tell: such a sensor is saturated or not connected.

    Args:
        name: of the point.
        point: which.
        registers: its own, as read.
        value: decoded from them, in the unit of the point's value.
        unsigned: the largest unsigned number is an end as well; a counter or an encoder may pass it.

    Raises:
        LinkError: if it is there.
    """
    if not point.dtype.is_float:
        bits = point.bit_count or 16 * point.dtype.registers
        signed = point.dtype.value.startswith("i") and not point.bit_count
        ends = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else ((1 << bits) - 1,) if unsigned and bits > 1 else ()
        if (number := number_in(point, registers)) in ends:
            raise LinkError(f"{name} (register {point.address}) is at the end of its range ({number}): {_SATURATED}")
    if point.range is not None and not point.range[0] < value < point.range[1]:
        raise LinkError(f"{name} (register {point.address}) is at the end of its range ({value:g}): {_SATURATED}")


_SATURATED = "the sensor is saturated or not connected; check sensor, cable and amplifier"


def decode_optional(point: RegisterPoint, registers: Sequence[int]) -> float | None:
    """The value of a point that may have none: a broken wire or an amplifier that is off reads as no number."""
    try:
        return decode(point, registers)
    except LinkError:
        return None


def decode_int(point: RegisterPoint, registers: Sequence[int]) -> int:
    """The value of a point that counts or names, without scale."""
    return round(decode(point, registers) / point.scale)


def encode(point: RegisterPoint, value: float) -> tuple[int, ...]:
    """The registers of a value.

    Raises:
        LinkError: if the value does not fit.
    """
    number = (value - point.offset) / point.scale
    try:
        raw = struct.pack(_FORMATS[point.dtype], number if point.dtype.is_float else round(number))
    except (struct.error, OverflowError, ValueError):
        raise LinkError(f"{value:g} does not fit into register {point.address} ({point.dtype}); correct the scale") from None
    if not math.isfinite(number):
        raise LinkError(f"{value:g} cannot be commanded (register {point.address})")
    registers = struct.unpack(f"{'>' if point.byte_order is WordOrder.HIGH_FIRST else '<'}{len(raw) // 2}H", raw)
    return registers if point.words is WordOrder.HIGH_FIRST else registers[::-1]
