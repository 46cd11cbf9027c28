"""Registers to values and back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.errors import BadConfig, LinkError
from semlive_drivers.modbus.codec import Block, block_of, decode, decode_int, decode_optional, encode, require_in_range
from semlive_drivers.modbus.registers import DType, Kind, RegisterPoint, StageMap, WordOrder, overridden


@pytest.mark.parametrize(
    ("point", "registers", "value"),
    [
        (RegisterPoint(Kind.INPUT, 0, DType.F32), (0x42C6, 0x8000), 99.25),
        (RegisterPoint(Kind.INPUT, 0, DType.F32, WordOrder.LOW_FIRST), (0x8000, 0x42C6), 99.25),
        (RegisterPoint(Kind.INPUT, 0, DType.F32, scale=-1000.0), (0x3FC0, 0x0000), -1500.0),
        (RegisterPoint(Kind.INPUT, 0, DType.U16), (0xFFFF,), 65_535.0),
        (RegisterPoint(Kind.INPUT, 0, DType.I16, scale=0.1), (0xFFFF,), -0.1),
        (RegisterPoint(Kind.INPUT, 0, DType.U32), (0x0001, 0x0000), 65_536.0),
        (RegisterPoint(Kind.INPUT, 0, DType.I32), (0xFFFF, 0xFFFE), -2.0),
        (RegisterPoint(Kind.INPUT, 0, DType.F64), (0x4058, 0xD000, 0x0000, 0x0000), 99.25),
        (RegisterPoint(Kind.INPUT, 0, DType.F64, WordOrder.LOW_FIRST), (0x0000, 0x0000, 0xD000, 0x4058), 99.25),
        (RegisterPoint(Kind.INPUT, 0, DType.F64, byte_order=WordOrder.LOW_FIRST), (0x5840, 0x00D0, 0x0000, 0x0000), 99.25),
        (RegisterPoint(Kind.INPUT, 0, DType.U64), (0x0000, 0x0001, 0x0000, 0x0000), 4_294_967_296.0),
        (RegisterPoint(Kind.INPUT, 0, DType.I64, scale=1e-6), (0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE), -2e-6),
    ],
)
def test_reference_registers_decode_and_encode_to_reference_values(point: RegisterPoint, registers: tuple[int, ...], value: float) -> None:
    assert decode(point, registers) == pytest.approx(value)
    assert encode(point, value) == registers


@pytest.mark.parametrize("registers", [(0x7FC0, 0), (0x7F80, 0), (0xFF80, 0)])
def test_what_is_no_finite_number_is_no_reading(registers: tuple[int, int]) -> None:
    with pytest.raises(LinkError, match=r"register 4 holds .*, which is no reading"):
        decode(RegisterPoint(Kind.INPUT, 4, DType.F32), registers)


def test_a_gage_with_a_broken_wire_reports_nothing_and_does_not_end_the_link() -> None:
    point = RegisterPoint(Kind.INPUT, 301, DType.F32, scale=1e-6)
    assert decode_optional(point, (0x7FC0, 0)) is None
    assert decode_optional(point, (0x42C6, 0x8000)) == pytest.approx(99.25e-6)


@pytest.mark.parametrize(
    ("dtype", "value"), [(DType.U16, -1.0), (DType.I16, 40_000.0), (DType.F32, 1e39), (DType.F32, math.nan), (DType.U16, math.nan)]
)
def test_what_does_not_fit_is_not_commanded(dtype: DType, value: float) -> None:
    with pytest.raises(LinkError, match=r"does not fit into register 7|cannot be commanded"):
        encode(RegisterPoint(Kind.HOLDING, 7, dtype), value)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=False), st.sampled_from(list(WordOrder)))
def test_a_float_survives_the_wire(value: float, words: WordOrder) -> None:
    point = RegisterPoint(Kind.HOLDING, 0, DType.F32, words)
    assert decode(point, encode(point, value)) == value


@pytest.mark.parametrize("value", [99.25, -250.5, 4096.0])
def test_a_round_float_with_its_words_swapped_is_no_reading(value: float) -> None:
    registers = encode(RegisterPoint(Kind.HOLDING, 0, DType.F32, WordOrder.HIGH_FIRST), value)
    with pytest.raises(LinkError, match="order of words"):
        decode(RegisterPoint(Kind.HOLDING, 0, DType.F32, WordOrder.LOW_FIRST), registers)


@given(st.integers(0, 2**32 - 1))
def test_a_counter_survives_the_wire(value: int) -> None:
    point = RegisterPoint(Kind.INPUT, 0, DType.U32)
    assert decode_int(point, encode(point, value)) == value


def test_a_block_holds_its_points() -> None:
    a, b = RegisterPoint(Kind.HOLDING, 10), RegisterPoint(Kind.HOLDING, 13, DType.F32)
    block = block_of((b, a))
    assert block == Block(Kind.HOLDING, 10, 5)
    assert block.slice(b) == slice(3, 5)


def test_points_of_two_tables_are_no_block() -> None:
    with pytest.raises(BadConfig, match="all be input or all be holding"):
        block_of((RegisterPoint(Kind.HOLDING, 0), RegisterPoint(Kind.INPUT, 1)))


def test_an_override_changes_only_what_it_names() -> None:
    changed = overridden(StageMap(), {"x": {"address": 300, "words": "low_first", "scale": "0.001"}}, "stage")
    assert changed.x == RegisterPoint(Kind.INPUT, 300, DType.F32, WordOrder.LOW_FIRST, 0.001)
    assert changed.y == StageMap().y


@pytest.mark.parametrize(
    ("point", "counts", "unsigned", "at_the_end"),
    [
        (RegisterPoint(Kind.INPUT, 4, DType.I16, scale=0.1), 32_767, True, True),
        (RegisterPoint(Kind.INPUT, 4, DType.I16, scale=0.1), -32_768, False, True),
        (RegisterPoint(Kind.INPUT, 4, DType.I16), -1, True, False),
        (RegisterPoint(Kind.INPUT, 4, DType.I32), 2**31 - 1, False, True),
        (RegisterPoint(Kind.INPUT, 4, DType.U16), 65_535, True, True),
        (RegisterPoint(Kind.INPUT, 4, DType.U16), 65_535, False, False),
        (RegisterPoint(Kind.INPUT, 4, DType.U16), 0x8000, True, False),
        (RegisterPoint(Kind.INPUT, 4, first_bit=0, bit_count=12), 0xFFF, True, True),
        (RegisterPoint(Kind.INPUT, 4, first_bit=0, bit_count=12), 0xFFE, True, False),
        (RegisterPoint(Kind.INPUT, 4, DType.I16, scale=0.1, range=(-400.0, 400.0)), 4_000, True, True),
        (RegisterPoint(Kind.INPUT, 4, DType.I16, scale=0.1, range=(-400.0, 400.0)), 3_999, True, False),
    ],
)
def test_a_reading_at_the_end_of_its_range_is_none(point: RegisterPoint, counts: int, unsigned: bool, at_the_end: bool) -> None:
    whole = RegisterPoint(point.kind, point.address, point.dtype)
    registers = encode(whole, counts)
    if not at_the_end:
        require_in_range("force", point, registers, decode(point, registers), unsigned=unsigned)
        return
    with pytest.raises(LinkError, match=r"force \(register 4\) is at the end of its range .*: the sensor is saturated or not connected"):
        require_in_range("force", point, registers, decode(point, registers), unsigned=unsigned)
