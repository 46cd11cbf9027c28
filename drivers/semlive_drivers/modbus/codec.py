"""Registers to values and back, without any IO."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from semlive.errors import BadConfig, LinkError
from semlive_drivers.modbus.registers import MAX_BLOCK, DType, Kind, Point, Words

_FORMATS = {DType.U16: ">H", DType.I16: ">h", DType.U32: ">I", DType.I32: ">i", DType.F32: ">f"}


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

    def slice(self, point: Point) -> slice:
        """Where a point lies in the block's registers."""
        first = point.address - self.address
        return slice(first, first + point.dtype.registers)


def block_of(points: Iterable[Point]) -> Block:
    """The smallest block that holds all points.

    Raises:
        BadConfig: if they lie in different tables or too far apart for one request.
    """
    points = tuple(points)
    kinds = {p.kind for p in points}
    if len(kinds) != 1:
        raise BadConfig("registers that are read together must all be input or all be holding registers; correct the register map")
    first = min(p.address for p in points)
    count = max(p.address + p.dtype.registers for p in points) - first
    if count > MAX_BLOCK:
        raise BadConfig(f"registers {first} to {first + count - 1} do not fit into one request of {MAX_BLOCK}; correct the register map")
    return Block(kinds.pop(), first, count)


def decode(point: Point, registers: Sequence[int]) -> float:
    """The value of a point from its own registers.

    Raises:
        LinkError: if it is not a finite number.
    """
    ordered = registers if point.words is Words.HIGH_FIRST else registers[::-1]
    raw = struct.pack(f">{len(ordered)}H", *ordered)
    (number,) = struct.unpack(_FORMATS[point.dtype], raw)
    value = number * point.scale
    if not math.isfinite(value):
        raise LinkError(f"register {point.address} holds {number}, which is no reading; check the sensor and the register map")
    return value


def decode_or_none(point: Point, registers: Sequence[int]) -> float | None:
    """The value of a point that may have none: a broken wire or an amplifier that is off reads as no number."""
    try:
        return decode(point, registers)
    except LinkError:
        return None


def decode_int(point: Point, registers: Sequence[int]) -> int:
    """The value of a point that counts or names, without scale."""
    return round(decode(point, registers) / point.scale)


def encode(point: Point, value: float) -> tuple[int, ...]:
    """The registers of a value.

    Raises:
        LinkError: if the value does not fit.
    """
    number = value / point.scale
    try:
        raw = struct.pack(_FORMATS[point.dtype], number if point.dtype is DType.F32 else round(number))
    except (struct.error, OverflowError, ValueError):
        raise LinkError(f"{value:g} does not fit into register {point.address} ({point.dtype}); correct the scale") from None
    if not math.isfinite(number):
        raise LinkError(f"{value:g} cannot be commanded (register {point.address})")
    registers = struct.unpack(f">{len(raw) // 2}H", raw)
    return registers if point.words is Words.HIGH_FIRST else registers[::-1]


def encode_block(block: Block, values: Mapping[Point, float]) -> tuple[int, ...]:
    """All registers of a block that is written in one request; gaps between points are zero."""
    registers = [0] * block.count
    for point, value in values.items():
        registers[block.slice(point)] = encode(point, value)
    return tuple(registers)
