"""Settings of the Modbus drivers."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from semlive.data.loading import StageKind
from semlive_drivers.settings import SerialLine


class ModbusSettings(BaseModel):
    """Settings of every Modbus driver."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    port: int = Field(default=502, ge=1, le=65_535)
    serial: SerialLine | None = None
    """Modbus RTU on this serial line instead of Modbus TCP."""
    unit: int = Field(default=1, ge=0, le=255)
    timeout_s: float = Field(default=0.3, gt=0, le=5)
    """Longest wait for one answer, wall time: a stop waits for at most one answer before it."""
    registers: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Points of the register map that differ at this machine."""


class DeviceSettings(ModbusSettings):
    """Settings of a device that is read continuously."""

    identity: int | None = Field(default=0x5E31, ge=0, le=65_535)
    """Expected value of the identity register; None disables the check."""
    frozen_after_s: float = Field(default=1.0, gt=0)
    """A counter of readings that does not change for this wall time means a frozen reading."""


class PartSettings(ModbusSettings):
    """Settings of a device that is described by a map."""

    map: str = "bench"
    """Name of a description that comes with semlive, or the path of another."""
    identity: int | Literal["map"] | None = "map"
    """Expected value of the first identity register if it is not the value in the map; None disables the check."""
    frozen_after_s: float = Field(default=1.0, gt=0)
    """A counter of readings that does not change for this wall time means a frozen reading."""
    watchdog_s: float = Field(default=2.0, ge=0, le=6_553)
    """The device stops by itself when it has not received a request for this wall time; 0 disables the watchdog."""
    strain_gage: bool = False
    """Read a strain gage on the specimen as well; `registers: {strain_gage: {address: ...}}` gives its register."""
    confirmed: bool = False
    """True if the description was compared with this machine (docs/reference/register-maps.md); otherwise no motion is ordered."""


class StageSettings(DeviceSettings):
    """Settings of the stage."""

    kind: StageKind = StageKind.SPECIMEN
    """What it moves: the specimen, or the beam."""
    first_register: int = Field(default=100, ge=3, le=65_000)
    """First register of its block, in input and holding registers; the bench has the specimen stage at 100, the beam shift at 400."""
