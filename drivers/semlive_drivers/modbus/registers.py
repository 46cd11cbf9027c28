"""Registers as data: how a number lies in a device. Where it lies is a register map (`device_map`, docs/reference/register-maps.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, TypeVar

from semlive.errors import BadConfig

MAX_BLOCK = 123
"""Most registers that one Modbus request can carry (FC16)."""


class Kind(StrEnum):
    """Which table: input registers (FC04), holding registers (FC03, 06, 16), coils (FC01, 05, 15), discrete inputs (FC02)."""

    INPUT = "input"
    HOLDING = "holding"
    COIL = "coil"
    DISCRETE = "discrete"

    @property
    def bits(self) -> bool:
        """Whether it holds single bits."""
        return self in (Kind.COIL, Kind.DISCRETE)


class DType(StrEnum):
    """How a number lies in registers."""

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
        """Registers that one value takes."""
        return int(self.value[1:]) // 16

    @property
    def is_float(self) -> bool:
        """Whether the number has a fraction of its own."""
        return self.value.startswith("f")


class WordOrder(StrEnum):
    """Order of the registers of a long number, or of the two bytes in a register."""

    HIGH_FIRST = "high_first"
    LOW_FIRST = "low_first"


@dataclass(frozen=True, slots=True)
class BitField:
    """Part of the word of another point.

    Attributes:
        point: whose word.
        first: lowest bit, from 0.
        count: how many bits.
    """

    point: str
    first: int = 0
    count: int = 16

    def of(self, word: int) -> int:
        """The number in these bits."""
        return word >> self.first & ((1 << self.count) - 1)


@dataclass(frozen=True, slots=True)
class Factor:
    """What another point says of the size of a number.

    Attributes:
        bits: where it is said.
        factors: by the number there, what to multiply with; None takes the number as that of decimals.
    """

    bits: BitField
    factors: tuple[tuple[int, float], ...] | None = None


@dataclass(frozen=True, slots=True)
class RegisterPoint:
    """One number in a device: value = (sign * number * factors) * scale + offset.

    Attributes:
        kind: which table.
        address: of the first register, from 0 as on the wire.
        dtype: how the number lies there.
        words: order of the registers of a long number.
        byte_order: order of the bytes in each register; Modbus says high first.
        scale: value of one count; -1 turns the sign, 1000 turns kN into N.
        offset: value of zero counts.
        first_bit: lowest bit of the word that belongs to the number.
        bit_count: how many bits; 0 takes all.
        sentinels: numbers that mean "no reading".
        sign: a bit that is set when the number is negative.
        factors: what other points say of its size (decimals, division, unit).
        range: values at or beyond which a reading is none, in the unit of the value; None where the map states none.
    """

    kind: Kind
    address: int
    dtype: DType = DType.U16
    words: WordOrder = WordOrder.HIGH_FIRST
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
            raise BadConfig(f"register address {self.address} does not exist; give one from 0 to {65_536 - self.dtype.registers}")
        if not self.scale:
            raise BadConfig(f"the scale of register {self.address} is 0; give the value of one count")
        if self.kind.bits and self.dtype is not DType.U16:
            raise BadConfig(f"bit {self.address} cannot hold {self.dtype}; leave dtype out")

    @property
    def needs(self) -> tuple[str, ...]:
        """Points whose words are needed to understand this one."""
        return (() if self.sign is None else (self.sign.point,)) + tuple(factor.bits.point for factor in self.factors)


@dataclass(frozen=True, slots=True)
class StageMap:
    """Where a stage keeps what."""

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
"""The points of a `StageMap` that are its own; the rest tell who answers."""


def stage_at(first_register: int) -> StageMap:
    """The map of a stage whose block begins elsewhere."""
    usual = StageMap()
    away = first_register - usual.motion.address
    points: dict[str, RegisterPoint] = {name: getattr(usual, name) for name in STAGE_POINTS}
    return replace(usual, **{name: replace(point, address=point.address + away) for name, point in points.items()})


@dataclass(frozen=True, slots=True)
class TriggerMap:
    """Where a scan generator is asked for a frame."""

    scan: RegisterPoint = RegisterPoint(Kind.HOLDING, 200)


Map = TypeVar("Map", StageMap, TriggerMap)


def overridden(registers: Map, overrides: Mapping[str, Mapping[str, Any]], where: str) -> Map:
    """A register map with some points replaced, field by field.

    Args:
        registers: the defaults.
        overrides: by name of the point, the fields of `RegisterPoint` that differ.
        where: what to call the settings in an error.

    Raises:
        BadConfig: for a point or field that does not exist, or a value that cannot be.
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
        changed[name] = _changed(points[name], values, f"{where}.{name}")
    return changed


def _range(given: Any) -> tuple[float, float]:
    low, high = (float(end) for end in given)
    if not low < high:
        raise ValueError("low end first")
    return low, high


def _changed(point: RegisterPoint, values: Mapping[str, Any], where: str) -> RegisterPoint:
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
            parsed[key] = parsers[key](value)
        except (TypeError, ValueError):
            raise BadConfig(f"{where}.{key} is {value!r}, which is no {parsers[key].__name__.strip('_')}; correct it") from None
    return replace(point, **parsed)
