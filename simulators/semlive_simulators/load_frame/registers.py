"""Encoding and decoding of the registers of the bench (docs/reference/bench-registers.md), without IO."""

from __future__ import annotations

import struct
from dataclasses import dataclass

IDENTITY = 0x5E31
MAP_VERSION = 1
_SIMULATOR, _HAS_WATCHDOG = 1, 2
STOPPED, MOVING, FAULT = 0, 1, 2


def f32(value: float) -> list[int]:
    """A float as two registers, high word first."""
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def u32(value: int) -> list[int]:
    """A counter as two registers, high word first; wraps."""
    return [(value >> 16) & 0xFFFF, value & 0xFFFF]


def read_f32(registers: list[int]) -> float:
    """Two registers, high word first, as a float."""
    return struct.unpack(">f", struct.pack(">HH", *registers))[0]


@dataclass(frozen=True, slots=True)
class LoadFrameInputs:
    """Input registers 0-15."""

    state: int
    force_n: float
    extension_mm: float
    target_n: float
    readings: int
    lag_s: float
    force_limit_n: float

    def registers(self) -> list[int]:
        """The sixteen registers from address 0."""
        head = [IDENTITY, MAP_VERSION, _SIMULATOR | _HAS_WATCHDOG, self.state]
        body = f32(self.force_n) + f32(self.extension_mm) + f32(self.target_n) + u32(self.readings)
        return head + body + f32(self.lag_s) + f32(self.force_limit_n)


@dataclass(frozen=True, slots=True)
class StageInputs:
    """Input registers 100-106, and 400-406 for the beam shift."""

    state: int
    x_um: float
    y_um: float
    readings: int

    def registers(self) -> list[int]:
        """The seven registers from the first."""
        return [self.state, *f32(self.x_um), *f32(self.y_um), *u32(self.readings)]


@dataclass(frozen=True, slots=True)
class DiagnosticInputs:
    """Input registers 300-304."""

    fault: int
    strain_gage: float
    readings: int

    def registers(self) -> list[int]:
        """The five registers from address 300."""
        return [self.fault, *f32(self.strain_gage), *u32(self.readings)]


@dataclass(frozen=True, slots=True)
class SemInputs:
    """Input registers 200-201."""

    scanning: bool
    exported: int

    def registers(self) -> list[int]:
        """The two registers from address 200."""
        return [int(self.scanning), self.exported & 0xFFFF]


@dataclass(frozen=True, slots=True)
class LoadFrameOrders:
    """Holding registers 0-7."""

    target_n: float
    rate_n_s: float
    command: int
    nonce: int
    heartbeat: int
    watchdog_s: float

    @classmethod
    def decoded(cls, registers: list[int]) -> LoadFrameOrders:
        """The orders in the eight registers at address 0."""
        command, nonce, heartbeat, tenths = registers[4:8]
        return cls(read_f32(registers[0:2]), read_f32(registers[2:4]), command, nonce, heartbeat, tenths * 0.1)


@dataclass(frozen=True, slots=True)
class StageOrders:
    """Holding registers 100-105, and 400-405 for the beam shift."""

    x_um: float
    y_um: float
    command: int

    @classmethod
    def decoded(cls, registers: list[int]) -> StageOrders:
        """The orders in six registers."""
        return cls(read_f32(registers[0:2]), read_f32(registers[2:4]), registers[4])


@dataclass(frozen=True, slots=True)
class CrossheadOrders:
    """Holding registers 300-305."""

    extension_mm: float
    speed_mm_s: float
    command: int

    @classmethod
    def decoded(cls, registers: list[int]) -> CrossheadOrders:
        """The orders in six registers."""
        return cls(read_f32(registers[0:2]), read_f32(registers[2:4]), registers[4])


@dataclass(frozen=True, slots=True)
class FaultOrders:
    """Holding registers 900-903."""

    what: int
    lines: int
    count: int
    wait_s: float

    @classmethod
    def decoded(cls, registers: list[int]) -> FaultOrders:
        """The orders in four registers."""
        what, lines, count, hundredths = registers
        return cls(what, lines, count, hundredths * 0.01)
