"""Dialogue with a device that is controlled by text (docs/reference/text-dialogues.md): questions, replies, orders."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from semlive.data.loading import MotionState
from semlive_drivers.device_part import PartCommand
from semlive_drivers.maps import Described, DeviceDescription, validate_map
from semlive_drivers.modbus.device_map import SerialConfig
from semlive_drivers.text.codec import CheckKind, Checksum, template_fields
from semlive_drivers.units import factor

ORDERED = ("force_n", "rate_n_s", "rate_n_min", "travel_mm", "to_mm", "speed_mm_s", "speed_mm_min", "station")
"""Names of values that a request may contain; ``to_mm`` is the end of a motion on the extension scale of the device."""


def _compiled(text: str) -> str:
    try:
        re.compile(text)
    except re.error as error:
        raise ValueError(f"is no regular expression: {error}") from None
    return text


class Query(Described):
    """A question."""

    send: str
    reply: Annotated[str, AfterValidator(_compiled)]
    """Pattern of the complete reply, with its lines joined by newlines; its groups name the values."""
    lines: int = Field(default=1, ge=1, le=20)


class BitRule(Described):
    """A bit of a status value that marks a reading as invalid."""

    group: str
    bit: int = Field(ge=0, le=31)
    equals: int = 0
    """Value of the bit in a valid reading."""
    for_s: float = Field(default=0.0, ge=0)
    """Time for which the bit may have the other value."""
    says: str
    """Message for the operator."""


class Step(Described):
    """One step of an order: a text that is sent, or a question with an expected reply."""

    send: str = ""
    ask: str = ""
    equals: dict[str, str] = Field(default_factory=dict)
    """Name of the value of the order that each group of the reply must equal."""
    tolerance: float = 0.01
    motion: MotionState | None = None
    """Expected motion state."""
    within_s: float = Field(default=0.0, ge=0, le=5)
    """Time for which the question is repeated."""


class OtherStop(Described):
    """A further method to stop the device, used when the device does not obey its stop order."""

    says: str = Field(min_length=1)
    """What the method does, for the operator."""
    steps: list[Step] = Field(min_length=1)


class ChecksumText(Described):
    """A checksum at the end of each line."""

    kind: CheckKind
    lead: str = ""


class TextProtocol(DeviceDescription):
    """The description of a device that is controlled by text."""

    protocol: Literal["ascii"]
    serial: SerialConfig = SerialConfig(baud=9600, parity="none", slowest_s=0.5)
    ends: str = "\r\n"
    """End of each line of a reply."""
    checksum: ChecksumText | None = None
    """Checksum of every request and of every line of a reply."""
    refused: str = ""
    """Complete reply with which the device refuses a request."""
    units: dict[str, str] = Field(default_factory=dict)
    """Units by group, for replies without a unit."""
    asks: dict[str, Query]
    every_turn: list[str] = Field(min_length=1)
    """Questions of every reading, in order."""
    identity: list[Step] = Field(default_factory=list)
    ranges: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Range of the sensor by group; a value at or beyond an end is no reading."""
    motion: dict[str, MotionState] = Field(default_factory=dict)
    """Motion state by the text of the group ``motion``."""
    valid: list[BitRule] = Field(default_factory=list)
    orders: dict[PartCommand, list[Step]] = Field(default_factory=dict)
    read_back: dict[PartCommand, list[Step]] = Field(default_factory=dict)
    """Further questions about an order, sent between the readings after it together with its own steps with ``equals``."""
    other_stops: list[OtherStop] = Field(default_factory=list)
    """Further methods to stop, in the order in which they are used; only those that the documents of the device state."""

    @property
    def check(self) -> Checksum | None:
        """The checksum as a value."""
        return None if self.checksum is None else Checksum(self.checksum.kind, self.checksum.lead)

    def groups(self) -> set[str]:
        """All groups in the replies of a reading."""
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
                raise ValueError(f"{template!r} contains {', '.join(sorted(unknown))}; there are {', '.join(ORDERED)}")
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
    """A dialogue by name or path.

    Raises:
        BadConfig: if it does not exist or is not valid.
    """
    return validate_map(TextProtocol, name)
