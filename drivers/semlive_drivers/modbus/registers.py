"""Register maps as data: which registers hold what. The defaults are the bench's (docs/bench-registers.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, TypeVar

from semlive.errors import BadConfig

MAX_BLOCK = 123
"""Most registers that one Modbus request can carry (FC16)."""


class Kind(StrEnum):
    """Which table a register is in."""

    INPUT = "input"
    HOLDING = "holding"


class DType(StrEnum):
    """How a number lies in registers."""

    U16 = "u16"
    I16 = "i16"
    U32 = "u32"
    I32 = "i32"
    F32 = "f32"

    @property
    def registers(self) -> int:
        """Registers that one value takes."""
        return 1 if self in (DType.U16, DType.I16) else 2


class Words(StrEnum):
    """Order of the registers of a 32-bit number."""

    HIGH_FIRST = "high_first"
    LOW_FIRST = "low_first"


@dataclass(frozen=True, slots=True)
class Point:
    """One number in a device.

    Attributes:
        kind: input or holding register.
        address: of the first register, from 0 as on the wire.
        dtype: how the number lies there.
        words: order of the registers of a 32-bit number.
        scale: value = scale * number; -1 turns the sign, 1000 turns kN into N.
    """

    kind: Kind
    address: int
    dtype: DType = DType.U16
    words: Words = Words.HIGH_FIRST
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.address <= 65_536 - self.dtype.registers:
            raise BadConfig(f"register address {self.address} does not exist; give one from 0 to {65_536 - self.dtype.registers}")
        if not self.scale:
            raise BadConfig(f"the scale of register {self.address} is 0; give the value of one count")


@dataclass(frozen=True, slots=True)
class LoadFrameMap:
    """Where a load frame keeps what; the points down to `force_limit` are read in one block, those from `target` written in one.

    `strain_gage` lies elsewhere, is asked for by itself, and only where the settings say that there is one.
    """

    identity: Point = Point(Kind.INPUT, 0)
    version: Point = Point(Kind.INPUT, 1)
    abilities: Point = Point(Kind.INPUT, 2)
    motion: Point = Point(Kind.INPUT, 3)
    force: Point = Point(Kind.INPUT, 4, DType.F32)
    extension: Point = Point(Kind.INPUT, 6, DType.F32)
    target_in_force: Point = Point(Kind.INPUT, 8, DType.F32)
    counter: Point = Point(Kind.INPUT, 10, DType.U32)
    lag: Point = Point(Kind.INPUT, 12, DType.F32)
    force_limit: Point = Point(Kind.INPUT, 14, DType.F32)
    target: Point = Point(Kind.HOLDING, 0, DType.F32)
    rate: Point = Point(Kind.HOLDING, 2, DType.F32)
    command: Point = Point(Kind.HOLDING, 4)
    nonce: Point = Point(Kind.HOLDING, 5)
    heartbeat: Point = Point(Kind.HOLDING, 6)
    watchdog: Point = Point(Kind.HOLDING, 7)
    strain_gage: Point = Point(Kind.INPUT, 301, DType.F32)


@dataclass(frozen=True, slots=True)
class StageMap:
    """Where a stage keeps what."""

    identity: Point = Point(Kind.INPUT, 0)
    version: Point = Point(Kind.INPUT, 1)
    abilities: Point = Point(Kind.INPUT, 2)
    motion: Point = Point(Kind.INPUT, 100)
    x: Point = Point(Kind.INPUT, 101, DType.F32)
    y: Point = Point(Kind.INPUT, 103, DType.F32)
    counter: Point = Point(Kind.INPUT, 105, DType.U32)
    target_x: Point = Point(Kind.HOLDING, 100, DType.F32)
    target_y: Point = Point(Kind.HOLDING, 102, DType.F32)
    command: Point = Point(Kind.HOLDING, 104)
    nonce: Point = Point(Kind.HOLDING, 105)


STAGE_POINTS = ("motion", "x", "y", "counter", "target_x", "target_y", "command", "nonce")
"""The points of a `StageMap` that are its own; the rest tell who answers."""


def stage_at(first_register: int) -> StageMap:
    """The map of a stage whose block begins elsewhere."""
    usual = StageMap()
    away = first_register - usual.motion.address
    points: dict[str, Point] = {name: getattr(usual, name) for name in STAGE_POINTS}
    return replace(usual, **{name: replace(point, address=point.address + away) for name, point in points.items()})


@dataclass(frozen=True, slots=True)
class TriggerMap:
    """Where a scan generator is asked for a frame."""

    scan: Point = Point(Kind.HOLDING, 200)


Map = TypeVar("Map", LoadFrameMap, StageMap, TriggerMap)


def overridden(registers: Map, overrides: Mapping[str, Mapping[str, Any]], where: str) -> Map:
    """A register map with some points replaced, field by field.

    Args:
        registers: the defaults.
        overrides: by name of the point, the fields of `Point` that differ.
        where: what to call the settings in an error.

    Raises:
        BadConfig: for a point or field that does not exist, or a value that cannot be.
    """
    names = [f.name for f in fields(registers)]
    changed: dict[str, Point] = {}
    for name, values in overrides.items():
        if name not in names:
            raise BadConfig(f"{where} has no register called {name!r}; it has {', '.join(names)}")
        changed[name] = _changed(getattr(registers, name), values, f"{where}.{name}")
    return replace(registers, **changed)


def _changed(point: Point, values: Mapping[str, Any], where: str) -> Point:
    parsers: dict[str, type] = {"address": int, "dtype": DType, "words": Words, "scale": float}
    parsed: dict[str, Any] = {}
    for key, value in values.items():
        if key not in parsers:
            raise BadConfig(f"{where} has no field {key!r}; it has {', '.join(parsers)}")
        try:
            parsed[key] = parsers[key](value)
        except (TypeError, ValueError):
            raise BadConfig(f"{where}.{key} is {value!r}, which is no {parsers[key].__name__}; correct it") from None
    return replace(point, **parsed)
