"""Registers as values: address and number format of each point (docs/reference/register-maps.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, TypeVar

from semlive.errors import BadConfig

MAX_BLOCK = 123
"""Largest number of registers in one Modbus request (FC16)."""


class Kind(StrEnum):
    """Modbus table: input registers (FC04), holding registers (FC03, 06, 16), coils (FC01, 05, 15), discrete inputs (FC02)."""

    INPUT = "input"
    HOLDING = "holding"
    COIL = "coil"
    DISCRETE = "discrete"

    @property
    def bits(self) -> bool:
        """Whether it holds single bits."""
        return self in (Kind.COIL, Kind.DISCRETE)

    @property
    def entry_name(self) -> str:
        """Name of one entry of the table in messages."""
        return {Kind.INPUT: "input register", Kind.HOLDING: "holding register", Kind.COIL: "coil"}.get(self, "discrete input")


class DType(StrEnum):
    """Number format in registers."""

    U16 = "u16"
    I16 = "i16"
    U32 = "u32"
    I32 = "i32"
    F32 = "f32"
    U64 = "u64"
    I64 = "i64"
    F64 = "f64"

    @property
    def registers(self) -> int:
        """Number of registers of one value."""
        return int(self.value[1:]) // 16

    @property
    def is_float(self) -> bool:
        """Whether the format is a floating-point format."""
        return self.value.startswith("f")


class WordOrder(StrEnum):
    """Order of the registers of a long number, or of the two bytes in a register."""

    HIGH_FIRST = "high_first"
    LOW_FIRST = "low_first"


@dataclass(frozen=True, slots=True)
class BitField:
    """Bits of the register of another point.

    Attributes:
        point: name of the point.
        first: lowest bit, from 0.
        count: number of bits.
    """

    point: str
    first: int = 0
    count: int = 16

    def of(self, register: int) -> int:
        """The number in these bits."""
        return register >> self.first & ((1 << self.count) - 1)


@dataclass(frozen=True, slots=True)
class Factor:
    """A factor of a number that another point determines.

    Attributes:
        bits: bits of the other point.
        factors: pairs of a number in these bits and its factor; None takes the number as the number of decimals.
    """

    bits: BitField
    factors: tuple[tuple[int, float], ...] | None = None


@dataclass(frozen=True, slots=True)
class RegisterPoint:
    """One number in a device: value = (sign * number * factors) * scale + offset.

    Attributes:
        kind: table.
        address: address of the first register, from 0 as on the wire.
        dtype: number format.
        word_order: order of the registers of a number with several registers.
        byte_order: order of the bytes in each register; the Modbus standard is high first.
        scale: value of one count; -1 inverts the sign, 1000 converts kN to N.
        offset: value of zero counts.
        first_bit: lowest bit of the number in the register.
        bit_count: number of bits; 0 takes all.
        sentinels: numbers that mean "no reading".
        sign: bit of another point that is set when the number is negative.
        factors: factors that other points determine (decimals, division, unit).
        range: range of the sensor in the unit of the value, at or beyond which there is no reading; None if the map states none.
    """

    kind: Kind
    address: int
    dtype: DType = DType.U16
    word_order: WordOrder = WordOrder.HIGH_FIRST
    scale: float = 1.0
    byte_order: WordOrder = WordOrder.HIGH_FIRST
    offset: float = 0.0
    first_bit: int = 0
    bit_count: int = 0
    sentinels: tuple[int, ...] = ()
    sign: BitField | None = None
    factors: tuple[Factor, ...] = ()
    range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.address <= 65_536 - self.dtype.registers:
            last = 65_536 - self.dtype.registers
            raise BadConfig(f"register address {self.address} does not exist; give one from 0 to {last} (400001 of a manual is 0 here)")
        if not self.scale:
            raise BadConfig(f"the scale of register {self.address} is 0; give the value of one count")
        if self.kind.bits and self.dtype is not DType.U16:
            raise BadConfig(f"bit {self.address} cannot hold {self.dtype}; leave dtype out")

    @property
    def needs(self) -> tuple[str, ...]:
        """Points whose registers are needed to decode this one."""
        return (() if self.sign is None else (self.sign.point,)) + tuple(factor.bits.point for factor in self.factors)


@dataclass(frozen=True, slots=True)
class StageMap:
    """Points of a stage."""

    identity: RegisterPoint = RegisterPoint(Kind.INPUT, 0)
    version: RegisterPoint = RegisterPoint(Kind.INPUT, 1)
    abilities: RegisterPoint = RegisterPoint(Kind.INPUT, 2)
    motion: RegisterPoint = RegisterPoint(Kind.INPUT, 100)
    x: RegisterPoint = RegisterPoint(Kind.INPUT, 101, DType.F32)
    y: RegisterPoint = RegisterPoint(Kind.INPUT, 103, DType.F32)
    counter: RegisterPoint = RegisterPoint(Kind.INPUT, 105, DType.U32)
    target_x: RegisterPoint = RegisterPoint(Kind.HOLDING, 100, DType.F32)
    target_y: RegisterPoint = RegisterPoint(Kind.HOLDING, 102, DType.F32)
    command: RegisterPoint = RegisterPoint(Kind.HOLDING, 104)
    nonce: RegisterPoint = RegisterPoint(Kind.HOLDING, 105)


STAGE_POINTS = ("motion", "x", "y", "counter", "target_x", "target_y", "command", "nonce")
"""The points of a `StageMap` in the block of the stage; the others identify the device."""


def stage_at(first_register: int) -> StageMap:
    """The map of a stage whose block begins at another register."""
    default = StageMap()
    shift = first_register - default.motion.address
    points: dict[str, RegisterPoint] = {name: getattr(default, name) for name in STAGE_POINTS}
    return replace(default, **{name: replace(point, address=point.address + shift) for name, point in points.items()})


@dataclass(frozen=True, slots=True)
class TriggerMap:
    """Points of a scan generator: writing 1 to `scan` requests a frame."""

    scan: RegisterPoint = RegisterPoint(Kind.HOLDING, 200)


Map = TypeVar("Map", StageMap, TriggerMap)


def overridden(registers: Map, overrides: Mapping[str, Mapping[str, Any]], where: str) -> Map:
    """A register map with some points replaced, field by field.

    Args:
        registers: the default points.
        overrides: fields of `RegisterPoint` that differ, by name of the point.
        where: name of the settings in an error.

    Raises:
        BadConfig: for a point or field that does not exist, or a value that is not valid.
    """
    points: dict[str, RegisterPoint] = {f.name: getattr(registers, f.name) for f in fields(registers)}
    return replace(registers, **overridden_points(points, overrides, where))


def overridden_points(
    points: Mapping[str, RegisterPoint], overrides: Mapping[str, Mapping[str, Any]], where: str
) -> dict[str, RegisterPoint]:
    """Points by name with some replaced, field by field; arguments and errors as for `overridden`."""
    changed = dict(points)
    for name, values in overrides.items():
        if name not in changed:
            raise BadConfig(f"{where} has no register called {name!r}; it has {', '.join(points)}")
        changed[name] = _with_changes(points[name], values, f"{where}.{name}")
    return changed


def _range(given: Any) -> tuple[float, float]:
    low, high = (float(end) for end in given)
    if not low < high:
        raise ValueError("low end first")
    return low, high


def _with_changes(point: RegisterPoint, values: Mapping[str, Any], where: str) -> RegisterPoint:
    parsers: dict[str, Callable[[Any], Any]] = {
        "address": int,
        "dtype": DType,
        "words": WordOrder,
        "byte_order": WordOrder,
        "scale": float,
        "offset": float,
        "kind": Kind,
        "range": _range,
    }
    parsed: dict[str, Any] = {}
    for key, value in values.items():
        if key not in parsers:
            raise BadConfig(f"{where} has no field {key!r}; it has {', '.join(parsers)}")
        try:
            parsed["word_order" if key == "words" else key] = parsers[key](value)
        except (TypeError, ValueError):
            raise BadConfig(f"{where}.{key} is {value!r}, which is no {parsers[key].__name__.strip('_')}; correct it") from None
    return replace(point, **parsed)
