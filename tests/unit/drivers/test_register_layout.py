"""Which register layout explains what a device answers: on registers that are made here, without a device."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace

import pytest

from semlive.data.checks import Verdict
from semlive.errors import BadConfig
from semlive_drivers.modbus.checking.choices import Measured
from semlive_drivers.modbus.checking.diagnosis import Diagnosis, diagnose
from semlive_drivers.modbus.checking.explanations import Described
from semlive_drivers.modbus.checking.reader import Register
from semlive_drivers.modbus.checking.refusals import exception_advice, refusal_findings
from semlive_drivers.modbus.checking.variants import WRITTEN
from semlive_drivers.modbus.device_map import load_map
from semlive_drivers.modbus.registers import DType, Kind, RegisterPoint, WordOrder
from semlive_drivers.panel_reading import PanelReading, parse_reading

FORCE_N, EXTENSION_MM = 123.456, 1.2345
GENERIC = load_map("generic")
POINTS = {name: text.point() for name, text in GENERIC.points.items()}
LOW = {name: replace(POINTS[name], word_order=WordOrder.LOW_FIRST) for name in ("force", "extension")}


def f32(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def swapped(registers: Sequence[int]) -> list[int]:
    return [(register & 255) << 8 | register >> 8 for register in registers]


def inputs(*registers: int, kind: Kind = Kind.INPUT, first: int = 0) -> dict[Register, int]:
    return {(kind, first + place): register for place, register in enumerate(registers)}


def diagnosed(
    registers: Mapping[Register, int],
    changed: Mapping[str, RegisterPoint] = {},
    force: str | None = None,
    extension: str | None = None,
    notations: tuple[int, ...] = (),
) -> Diagnosis:
    """The diagnosis of the map ``generic`` with changed points, on a device whose other registers are 0."""
    panel: dict[str, PanelReading | None] = {
        "force": parse_reading(force, "--force-reads") if force else None,
        "extension": parse_reading(extension, "--extension-reads") if extension else None,
    }
    measured = tuple(Measured(name, GENERIC.plausible[name], panel[name]) for name in panel)
    described = Described(GENERIC, {**POINTS, **changed}, measured, notations)
    return diagnose(described, {place: [registers.get(place, 0)] * 3 for place in described.needed()})


def order_of(diagnosis: Diagnosis) -> tuple[Verdict, str, str]:
    finding = diagnosis.findings[0]
    assert finding.what == "order of words"
    return finding.verdict, finding.observation, finding.advice


def test_a_right_map_makes_sense_and_is_not_proved_without_the_panel() -> None:
    registers = inputs(*f32(FORCE_N), *f32(EXTENSION_MM))
    alone = diagnosed(registers)
    assert order_of(alone)[:2] == (Verdict.OK, "force, extension: high word first makes sense")
    assert not alone.proved
    assert diagnosed(registers, force="123.456", extension="1.2345").proved
    assert not diagnosed(registers, force="123.456").proved
    assert not diagnosed(registers, force="123.46", extension="0").proved


@pytest.mark.parametrize("described", [{}, LOW], ids=["as described", "low word first, as wrong advice"])
def test_an_address_off_by_one_is_found_whatever_order_the_map_states(described: Mapping[str, RegisterPoint]) -> None:
    verdict, observation, advice = order_of(diagnosed(inputs(0, *f32(FORCE_N), *f32(EXTENSION_MM)), described))
    assert verdict is Verdict.FAILED
    assert observation == "force, extension: address + 1, high word first makes sense"
    assert "force: {kind: input, address: 1, dtype: f32, words: high_first}" in advice


def test_where_two_layouts_give_the_same_values_both_are_named_and_how_to_decide() -> None:
    round_numbers = inputs(0, *f32(123.5), *f32(1.25))
    verdict, observation, advice = order_of(diagnosed(round_numbers, LOW))
    assert verdict is Verdict.UNKNOWN
    assert "2 explanations fit: force, extension: low word first; or force, extension: address + 1, high word first" in observation
    assert "press on the cell by hand" in advice
    assert "known weight" in advice
    with_panel = diagnosed(round_numbers, LOW, force="123.5", extension="1.25")
    assert not with_panel.proved
    assert "no round number" in order_of(with_panel)[2]


@pytest.mark.parametrize(
    ("registers", "words"),
    [
        (inputs(*f32(123.5), *f32(1.25), kind=Kind.HOLDING), "holding register instead of input register (function code 3 instead of 4)"),
        (inputs(*f32(FORCE_N)[::-1], *f32(EXTENSION_MM)[::-1]), "low word first"),
        (inputs(*swapped([*f32(FORCE_N), *f32(EXTENSION_MM)])), "high word first, bytes swapped"),
    ],
    ids=["table", "words", "bytes"],
)
def test_register_and_byte_order_table(registers: dict[Register, int], words: str) -> None:
    verdict, observation, _ = order_of(diagnosed(registers))
    assert verdict is Verdict.FAILED
    assert words in observation


def test_addresses_from_30001_are_counted_from_0() -> None:
    numbered = {name: replace(point, address=point.address + 30_001) for name, point in POINTS.items() if point.kind is Kind.INPUT}
    verdict, observation, advice = order_of(diagnosed(inputs(*f32(FORCE_N), *f32(EXTENSION_MM)), numbered, notations=WRITTEN))
    assert verdict is Verdict.FAILED
    assert "address - 30001" in observation
    assert "address: 0" in advice


@pytest.mark.parametrize(
    ("scale", "right"), [(0.1, "scale 1 instead of 0.1"), (-1.0, "scale 1 instead of -1"), (2.0**-12, "scale 1 instead of 0.000244141")]
)
def test_the_panel_shows_the_scale(scale: float, right: str) -> None:
    changed = {"force": replace(POINTS["force"], scale=scale)}
    verdict, observation, _ = order_of(diagnosed(inputs(*f32(FORCE_N), *f32(EXTENSION_MM)), changed, force="123.456", extension="1.2345"))
    assert verdict is Verdict.FAILED
    assert right in observation


def test_a_positive_number_shows_no_sign_and_a_negative_one_does() -> None:
    integer = {
        "force": replace(POINTS["force"], dtype=DType.I16, scale=0.1),
        "extension": replace(POINTS["extension"], dtype=DType.I32, scale=0.0001),
    }
    positive = diagnosed(inputs(1235, 7, 0, 12345), integer, force="123.5", extension="1.2345")
    assert not positive.proved
    assert "u16 instead of i16" in order_of(positive)[1]
    assert "in the other direction" in order_of(positive)[2]
    assert diagnosed(inputs(65536 - 1235, 7, 65535, 65536 - 12345), integer, force="-123.5", extension="-1.2345").proved


def test_a_panel_that_shows_something_else_is_no_proof() -> None:
    found = diagnosed(inputs(*f32(FORCE_N), *f32(EXTENSION_MM)), force="77.31", extension="1.2345")
    assert not found.proved
    assert any("no address, number format or scale" in finding.observation for finding in found.findings)


def test_zeros_give_no_layout() -> None:
    found = diagnosed({})
    assert order_of(found)[0] is Verdict.UNKNOWN
    assert not found.proved


@pytest.mark.parametrize("text", ["", "about 3", "nan", "1,5"])
def test_a_reading_is_a_decimal_number(text: str) -> None:
    with pytest.raises(BadConfig, match="give the digits of the device's panel"):
        parse_reading(text, "--force-reads")


def test_every_exception_has_one_advice() -> None:
    texts = [exception_advice(code, "force") for code in (1, 2, 3, 4, 5, 6, 7, 8, 10, 11)]
    assert len(set(texts)) == len(texts)
    refused: dict[str, int] = {"force": 11, "motion": 11}
    requests = {"force": "input register 0", "motion": "input register 4"}
    (one,) = refusal_findings("device", refused, requests)
    assert one.what == "force, motion"
    assert "did not answer (exception 11)" in one.observation
    assert "serial side of the gateway" in one.advice
