"""Settings of the Modbus drivers, checked at the door."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.data.loading import StageKind
from semlive.errors import BadConfig
from semlive.inputs.kinds import changed_kind


class SerialLine(BaseModel):
    """A serial line in place of host and port; what is left out is as the device's description says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str
    baud: int | None = Field(default=None, ge=300, le=4_000_000)
    parity: Literal["none", "even", "odd"] | None = None
    stop_bits: Literal[1, 2] | None = None
    silence_s: float | None = Field(default=None, ge=0, le=1)
    slowest_s: float | None = Field(default=None, gt=0, le=3)
    echo: bool = False

    def over(self, usual: BaseModel) -> dict[str, Any]:
        """What is said here, and for the rest what is usual."""
        return {**usual.model_dump(), **self.model_dump(exclude_none=True)}


class ModbusSettings(BaseModel):
    """What every Modbus driver needs."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    port: int = Field(default=502, ge=1, le=65_535)
    serial: SerialLine | None = None
    """Modbus RTU over this line, in place of Modbus TCP."""
    unit: int = Field(default=1, ge=0, le=255)
    timeout_s: float = Field(default=0.3, gt=0, le=5)
    """Longest wait for one answer, wall time: a stop waits for at most one answer before it."""
    registers: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Points of the register map that differ here."""


class DeviceSettings(ModbusSettings):
    """What a device that is read continuously needs."""

    identity: int | None = Field(default=0x5E31, ge=0, le=65_535)
    """What the identity register must hold; None leaves it unchecked."""
    frozen_after_s: float = Field(default=1.0, gt=0)
    """A counter of readings that stands still for this long of wall time means a frozen reading."""


class PartSettings(ModbusSettings):
    """Settings of a device that is described by a map."""

    map: str = "bench"
    """Name of a description that comes with semlive, or the path of another."""
    identity: int | Literal["map"] | None = "map"
    """What the first identity register must hold, if not what the map says; None leaves identity unchecked."""
    frozen_after_s: float = Field(default=1.0, gt=0)
    """A counter of readings that stands still for this long of wall time means a frozen reading."""
    watchdog_s: float = Field(default=2.0, ge=0, le=6_553)
    """The device stops by itself when it has not been spoken to for this long of wall time; 0 is off."""
    strain_gage: bool = False
    """A strain gage on the specimen is read along; `registers: {strain_gage: {address: ...}}` says where."""
    confirmed: bool = False
    """Somebody has held the description beside this machine (docs/reference/register-maps.md); without that nothing is moved by it."""


class StageSettings(DeviceSettings):
    """Settings of the stage."""

    kind: StageKind = StageKind.SPECIMEN
    """What it moves: the specimen, or the beam."""
    first_register: int = Field(default=100, ge=3, le=65_000)
    """Where its block begins, in input and holding registers alike; the bench has the specimen stage at 100, the beam's shift at 400."""


S = TypeVar("S", bound=BaseModel)


def checked(model: type[S], settings: Mapping[str, object], driver: str) -> S:
    """Settings as values.

    Raises:
        BadConfig: for the first key or value that is wrong.
    """
    try:
        known = model.model_validate(dict(settings))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "settings"
        allowed = f"; it has {', '.join(model.model_fields)}" if first["type"] == "extra_forbidden" else ""
        raise BadConfig(f"{driver}: {key}: {first['msg'][0].lower()}{first['msg'][1:]}{allowed}") from None
    changed = changed_kind(settings, known)
    if changed is not None:
        raise BadConfig(f"{driver}: {'.'.join(map(str, changed[0]))}: {changed[1]}")
    return known
