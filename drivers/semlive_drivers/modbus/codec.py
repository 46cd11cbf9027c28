"""Conversion between registers and values, without IO."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from semlive.errors import BadConfig, LinkError
from semlive_drivers.device_part import SATURATED
from semlive_drivers.modbus.registers import MAX_BLOCK, DType, Kind, RegisterPoint, WordOrder

_FORMATS = {
    **{DType.U16: ">H", DType.I16: ">h", DType.U32: ">I", DType.I32: ">i", DType.F32: ">f"},
    **{DType.U64: ">Q", DType.I64: ">q", DType.F64: ">d"},
}

_MIN_NORMAL = 2.0**-126
"""The smallest normal number of 32 bits; decimal numbers with swapped registers are smaller: 99.25 is read as 4.6e-41."""


@dataclass(frozen=True, slots=True)
class Block:
    """Registers that are read or written in one request.

    Attributes:
        kind: table.
        address: first register.
        count: number of registers.
    """

    kind: Kind
    address: int
    count: int

    def slice(self, point: RegisterPoint) -> slice:
        """The registers of a point in the block."""
        first = point.address - self.address
        return slice(first, first + point.dtype.registers)


def block_of(points: Iterable[RegisterPoint], max_block: int = MAX_BLOCK) -> Block:
    """The smallest block that holds all points.

    Args:
        points: one point or more.
        max_block: largest number of registers in one request.

    Raises:
        BadConfig: if the points are in different tables or too far apart for one request.
    """
    points = tuple(points)
    kinds = {point.kind for point in points}
    if len(kinds) != 1:
        raise BadConfig("registers that are read together must all be input or all be holding registers; correct the register map")
    first = min(point.address for point in points)
    count = max(point.address + point.dtype.registers for point in points) - first
    if count > max_block:
        raise BadConfig(f"registers {first} to {first + count - 1} do not fit into one request of {max_block}; correct the register map")
    return Block(kinds.pop(), first, count)


def number_in(point: RegisterPoint, registers: Sequence[int]) -> float | int:
    """The unscaled number of a point, before sign, factors and scale."""
    ordered = registers if point.word_order is WordOrder.HIGH_FIRST else registers[::-1]
    raw = struct.pack(f"{'>' if point.byte_order is WordOrder.HIGH_FIRST else '<'}{len(ordered)}H", *ordered)
    (number,) = struct.unpack(_FORMATS[point.dtype], raw)
    if point.bit_count:
        return number >> point.first_bit & ((1 << point.bit_count) - 1)
    return number


def decode(point: RegisterPoint, registers: Sequence[int], all_registers: Mapping[str, Sequence[int]] | None = None) -> float:
    """The value of a point from its own registers.

    Args:
        point: the point.
        registers: registers of the point, as read.
        all_registers: registers of the points that determine its sign and factors, by name; None if there are none.

    Raises:
        LinkError: if the number is not finite, or means that there is no reading.
    """
    number = number_in(point, registers)
    value = number * point.scale
    if not math.isfinite(value) or number in point.sentinels:
        raise LinkError(f"register {point.address} holds {number}, which is no reading; check the sensor and the register map")
    if point.dtype.is_float and 0 < abs(number) < _MIN_NORMAL:
        raise LinkError(f"register {point.address} holds {number:g}, which no device sends; check the order of words in the register map")
    if point.sign is not None or point.factors:
        value *= _factor_of(point, all_registers or {})
    return value + point.offset


def _factor_of(point: RegisterPoint, all_registers: Mapping[str, Sequence[int]]) -> float:
    """Sign and factors of a number that other points determine."""
    product = -1.0 if point.sign is not None and point.sign.of(all_registers[point.sign.point][0]) else 1.0
    for factor in point.factors:
        number = factor.bits.of(all_registers[factor.bits.point][0])
        if factor.factors is None:
            product *= 10.0**-number
            continue
        factors = dict(factor.factors)
        if number not in factors:
            raise LinkError(
                f"{factor.bits.point} is {number}, and the register map does not state what this means for register {point.address}; "
                "check the device's settings and the map"
            )
        product *= factors[number]
    return product


def count_of(point: RegisterPoint, all_registers: Mapping[str, Sequence[int]] | None = None) -> float:
    """Value of one count of a point, always positive; 0 for floats, whose number format has no fixed step.

    Args:
        point: the point.
        all_registers: registers of the points that determine its sign and factors, by name; None if there are none.

    Raises:
        LinkError: if the map does not list the number in one of them.
    """
    return 0.0 if point.dtype.is_float else abs(point.scale * _factor_of(point, all_registers or {}))


def require_in_range(name: str, point: RegisterPoint, registers: Sequence[int], value: float, *, unsigned: bool) -> None:
    """Refuse a reading at the end of its number format or of its sensor: such a sensor is saturated or not connected.

    Args:
        name: name of the point.
        point: the point.
        registers: registers of the point, as read.
        value: decoded value, in the unit of the point's value.
        unsigned: whether the largest unsigned number is an end of the range too; a counter or an encoder may pass it.

    Raises:
        LinkError: if the reading is at an end.
    """
    if not point.dtype.is_float:
        bits = point.bit_count or 16 * point.dtype.registers
        signed = point.dtype.value.startswith("i") and not point.bit_count
        ends = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else ((1 << bits) - 1,) if unsigned and bits > 1 else ()
        if (number := number_in(point, registers)) in ends:
            raise LinkError(f"{name} (register {point.address}) is at the end of its range ({number}): {SATURATED}")
    if point.range is not None and not point.range[0] < value < point.range[1]:
        raise LinkError(f"{name} (register {point.address}) is at the end of its range ({value:g}): {SATURATED}")


def decode_optional(point: RegisterPoint, registers: Sequence[int]) -> float | None:
    """The value of a point, or None if there is no reading, as with a broken wire or an amplifier that is off."""
    try:
        return decode(point, registers)
    except LinkError:
        return None


def decode_int(point: RegisterPoint, registers: Sequence[int]) -> int:
    """The number of a counter or a code, without scale."""
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
    return registers if point.word_order is WordOrder.HIGH_FIRST else registers[::-1]
