"""A device that speaks text, described as data (docs/reference/text-dialogues.md): questions, answers, orders."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from semlive.data.loading import MotionState
from semlive_drivers.device_part import PartCommand
from semlive_drivers.maps import validate_map
from semlive_drivers.modbus.device_map import SerialConfig
from semlive_drivers.text.codec import CheckKind, Checksum, template_fields
from semlive_drivers.units import factor

ORDERED = ("force_n", "rate_n_s", "rate_n_min", "travel_mm", "to_mm", "speed_mm_s", "speed_mm_min", "station")
"""What a request may contain; ``to_mm`` is where a way ends, by the device's own reading."""


class _Described(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _compiled(text: str) -> str:
    try:
        re.compile(text)
    except re.error as error:
        raise ValueError(f"is no regular expression: {error}") from None
    return text


class Query(_Described):
    """A question."""

    send: str
    reply: Annotated[str, AfterValidator(_compiled)]
    """Pattern of the whole reply, its lines joined by one newline; groups name what it says."""
    lines: int = Field(default=1, ge=1, le=20)


class BitRule(_Described):
    """A bit of a status word that makes a reading none."""

    group: str
    bit: int = Field(ge=0, le=31)
    equals: int = 0
    """What the bit must be."""
    for_s: float = Field(default=0.0, ge=0)
    """How long it may be otherwise."""
    says: str


class Step(_Described):
    """One step of an order: something that is sent, or a question whose answer must be right."""

    send: str = ""
    ask: str = ""
    equals: dict[str, str] = {}
    """By group of the reply, the value of the order that must be read back."""
    tolerance: float = 0.01
    motion: MotionState | None = None
    """What motion must be said."""
    within_s: float = Field(default=0.0, ge=0, le=5)
    """The question is asked again for so long."""


class OtherStop(_Described):
    """A further way to stop the device, tried when it does not obey its stop order."""

    says: str = Field(min_length=1)
    """What it does, for a person."""
    steps: list[Step] = Field(min_length=1)


class ChecksumText(_Described):
    """A checksum at the end of each line."""

    kind: CheckKind
    lead: str = ""


class TextProtocol(_Described):
    """A whole description."""

    protocol: Literal["ascii"]
    name: str
    source: str
    confirmed: bool = False
    """True only where the device itself was seen to move as described; otherwise motion asks for `confirmed: true` in the configuration."""
    notes: str = ""
    serial: SerialConfig = SerialConfig(baud=9600, parity="none", slowest_s=0.5)
    ends: str = "\r\n"
    """Of each line of a reply."""
    checksum: ChecksumText | None = None
    """On every request and on every line of a reply."""
    refused: str = ""
    """A reply of just this means: I do not understand, or will not."""
    units: dict[str, str] = {}
    """Usual units by group, where the reply does not tell."""
    asks: dict[str, Query]
    every_turn: list[str] = Field(min_length=1)
    """Questions of every reading, in order."""
    identity: list[Step] = []
    plausible: dict[str, tuple[float, float]] = {}
    """Between which values a group lies at rest."""
    ranges: dict[str, tuple[float, float]] = {}
    """By group, the values at or beyond which a reading is none: the ends of the sensor."""
    motion: dict[str, MotionState] = {}
    """What the words of the group ``motion`` mean."""
    valid: list[BitRule] = []
    orders: dict[PartCommand, list[Step]] = {}
    read_back: dict[PartCommand, list[Step]] = {}
    """Questions about an order that are asked between the readings after it, as are those of the order that compare with ``equals``."""
    other_stops: list[OtherStop] = []
    """Further ways to stop, in the order in which they are tried; only what the device's documents state."""

    @property
    def check(self) -> Checksum | None:
        """The checksum as a value."""
        return None if self.checksum is None else Checksum(self.checksum.kind, self.checksum.lead)

    def groups(self) -> set[str]:
        """Everything that every reading tells."""
        return {group for name in self.every_turn for group in re.compile(self.asks[name].reply).groupindex}

    @model_validator(mode="after")
    def _fits_together(self) -> TextProtocol:
        every = (*self.orders.values(), *self.read_back.values(), self.identity, *(stop.steps for stop in self.other_stops))
        steps = [step for steps in every for step in steps]
        for name in (*self.every_turn, *(step.ask for step in steps if step.ask)):
            if name not in self.asks:
                raise ValueError(f"{name!r} is not among asks")
        for template in (*(ask.send for ask in self.asks.values()), *(step.send for step in steps)):
            if unknown := template_fields(template) - set(ORDERED):
                raise ValueError(f"{template!r} wants {', '.join(sorted(unknown))}; there are {', '.join(ORDERED)}")
        for step in steps:
            if bool(step.send) == bool(step.ask):
                raise ValueError("a step either sends or asks")
            if unknown := set(step.equals.values()) - set(ORDERED):
                raise ValueError(f"a step compares with {', '.join(sorted(unknown))}; there are {', '.join(ORDERED)}")
        if any(not step.equals for steps in self.read_back.values() for step in steps):
            raise ValueError("a step of read_back asks and compares with equals")
        for unit in self.units.values():
            factor(unit, "units")
        for group, (low, high) in self.ranges.items():
            if group not in self.groups():
                raise ValueError(f"ranges needs {group!r}, which no question of every_turn asks")
            if not low < high:
                raise ValueError(f"ranges.{group} must give the low end first")
        for group in {*(rule.group for rule in self.valid)} - self.groups():
            raise ValueError(f"valid needs {group!r}, which no question of every_turn asks")
        return self


def load_dialogue(name: str) -> TextProtocol:
    """A description by name or path.

    Raises:
        BadConfig: if there is none, or something in it is wrong.
    """
    return validate_map(TextProtocol, name)
