"""Conversion between text and values, without IO: templates of requests, patterns of replies, checksums."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from semlive.errors import LinkError
from semlive_drivers.modbus.rtu.frames import crc16
from semlive_drivers.order_exactness import is_rounded_down, require_exact, towards_zero, unit_of
from semlive_drivers.units import factor

_PLACE = re.compile(r"\{(?P<name>[a-z_0-9]+)(?::(?P<sign>\+?)(?P<digits>\d+)(?:\.(?P<decimals>\d+))?(?P<outward>!?))?\}")

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?")


class CheckKind(StrEnum):
    """Algorithm of a checksum: exclusive-or of all bytes, their sum modulo 256, or the CRC-16 of Modbus, low byte first."""

    XOR = "xor"
    SUM = "sum"
    CRC16 = "crc16"


@dataclass(frozen=True, slots=True)
class Checksum:
    """Hexadecimal digits between the text and its end.

    Attributes:
        kind: algorithm.
        lead: text before the digits; not part of the sum.
    """

    kind: CheckKind
    lead: str = ""

    def of(self, text: bytes) -> bytes:
        """Lead and digits for a text."""
        total = 0
        for byte in text:
            total = total ^ byte if self.kind is CheckKind.XOR else (total + byte) & 0xFF
        digits = crc16(text).hex() if self.kind is CheckKind.CRC16 else f"{total:02x}"
        return self.lead.encode() + digits.upper().encode()


def template_fields(template: str) -> set[str]:
    """The names of values in a template."""
    return {place["name"] for place in _PLACE.finditer(template)}


def step_of(template: str, name: str) -> float:
    """Smallest step of a value in a request; 0 if the request does not contain it."""
    return next((10.0 ** -int(place["decimals"] or 0) for place in _PLACE.finditer(template) if place["name"] == name), 0.0)


def fill_template(template: str, values: Mapping[str, float], *, exact: bool = True) -> bytes:
    """A request.

    Args:
        template: text with places ``{name:+D.d!}``: at least D digits before the point, with leading zeros, d digits after it, a plus
            sign with ``+``, and rounded away from zero with ``!``. Speeds and travels are rounded towards zero.
        values: values by name.
        exact: refuse values that the format changes too much (`require_exact`).

    Raises:
        LinkError: if a value does not fit, or is refused.
    """

    def put(place: re.Match[str]) -> str:
        value, digits, decimals = values[place["name"]], int(place["digits"] or 1), int(place["decimals"] or 0)
        counts = abs(value) * 10**decimals
        if not math.isfinite(counts):
            raise LinkError(f"{value:g} cannot be commanded ({place['name']})")
        rounded = (
            math.ceil(round(counts, 6)) if place["outward"] else towards_zero(counts) if is_rounded_down(place["name"]) else round(counts)
        )
        if exact:
            stored, where = math.copysign(rounded / 10**decimals, value), f"the {decimals} decimals of {place['name']} in {template!r}"
            require_exact(place["name"], value, stored, where, unit_of(place["name"]))
        text = f"{rounded / 10**decimals:0{digits + (decimals + 1 if decimals else 0)}.{decimals}f}"
        if len(text.partition(".")[0]) > digits > 1:
            raise LinkError(f"{value:g} does not fit into {digits} digits ({place['name']})")
        return ("-" if value < 0 and rounded else "+" if place["sign"] else "") + text

    return _PLACE.sub(put, template).encode("ascii")


def with_check(text: bytes, checksum: Checksum | None) -> bytes:
    """A request with its checksum, if the device requires one."""
    return text if checksum is None else text + checksum.of(text)


def without_check(line: bytes, checksum: Checksum | None, where: str) -> bytes:
    """A reply without its checksum.

    Raises:
        LinkError: if the checksum is wrong.
    """
    if checksum is None:
        return line
    length = len(checksum.of(b""))
    text, digits = line[:-length], line[-length:]
    if len(line) < length or digits.upper() != checksum.of(text):
        raise LinkError(f"{where} gave a reply with a wrong checksum: {printable(line)}; check cable and baud rate")
    return text


class NotUnderstood(LinkError):
    """A reply that does not fit the pattern of its question."""


def parse_reply(pattern: re.Pattern[str], text: str, units: Mapping[str, str], where: str) -> dict[str, str | float]:
    """The values in a reply by the groups of its pattern; numbers are converted to N, mm and s.

    Args:
        pattern: groups ``force``, ``extension``, ``target`` and ``gage`` are numbers; a group ``..._unit`` is the unit in the reply.
        text: the reply.
        units: units by group, for groups without a unit in the reply.
        where: name of the device in an error.

    Raises:
        NotUnderstood: if the reply does not fit the pattern.
        LinkError: if a number in it is no reading.
    """
    match = pattern.fullmatch(text)
    if match is None:
        received = printable(text.encode(errors="replace"))
        raise NotUnderstood(f"{where} sent {received}, which is no answer to the question; check the device and its description")
    reply: dict[str, str | float] = {}
    for name, value in match.groupdict().items():
        if value is None or name.endswith("_unit"):
            continue
        try:
            number = float(value)
        except ValueError:
            reply[name] = value
            continue
        unit = match.groupdict().get(f"{name}_unit") or units.get(name, "1")
        reply[name] = number * factor(unit, f"{where}: {name}")
        if not math.isfinite(number):
            raise LinkError(f"{where} sent {value} for {name}, which is no reading; check the sensor")
    return reply


def resolutions(pattern: re.Pattern[str], text: str, units: Mapping[str, str], where: str) -> dict[str, float]:
    """The step of each number in a reply by its last decimal, in N, mm and s; arguments as for `parse_reply`."""
    match, steps = pattern.fullmatch(text), dict[str, float]()
    for name, value in (match.groupdict() if match else {}).items():
        if value is not None and _NUMBER.fullmatch(value):
            unit = match[f"{name}_unit"] if match and f"{name}_unit" in pattern.groupindex else units.get(name, "1")
            steps[name] = 10.0 ** -len(value.partition(".")[2]) * factor(unit or "1", f"{where}: {name}")
    return steps


def printable(line: bytes) -> str:
    """Bytes as printable text in quotes."""
    return repr(line[:60].decode("ascii", errors="backslashreplace"))
