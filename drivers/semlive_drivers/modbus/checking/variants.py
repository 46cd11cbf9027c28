"""Errors that concern a complete description: counting of addresses, table, order of registers and bytes. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from semlive_drivers.modbus.registers import DType, Kind, RegisterPoint, WordOrder

_OPPOSITE = {WordOrder.HIGH_FIRST: WordOrder.LOW_FIRST, WordOrder.LOW_FIRST: WordOrder.HIGH_FIRST}
OTHER_KIND = {Kind.INPUT: Kind.HOLDING, Kind.HOLDING: Kind.INPUT}
_NEAR_BITS = {0: 0.0, 1: 3.0, -1: 3.0, 2: 6.0, -2: 6.0}
_NOTATION_BITS = 3.0
_KIND_BITS, _WORDS_BITS, _BYTES_BITS = 3.0, 2.5, 4.0
_LOCAL_NEAR_BITS = {0: 0.0, 1: 4.0, -1: 4.0, 2: 7.0, -2: 7.0}
_LOCAL_KIND_BITS, _LOCAL_WORDS_BITS, _LOCAL_BYTES_BITS = 6.0, 5.0, 7.0
_SIGN_BITS, _WIDTH_BITS, _FLOAT_BITS, _RARE_BITS = 2.5, 4.0, 4.0, 2.0
INPUT_BASE, HOLDING_BASE = 30_001, 40_001
"""Number of the first register of each table in the notation with the table as the first digit."""


@dataclass(frozen=True, slots=True)
class Variant:
    """Changes to all points of a description.

    Attributes:
        near: added to all addresses.
        notation: 0, or what is subtracted from addresses in the notation 40001 (1), or 40000 (2); -1 and -2 add it.
        swap_kind: input registers become holding registers, and the reverse.
        swap_words: the order of the registers of long numbers is reversed.
        swap_bytes: the order of the bytes is reversed.
    """

    near: int = 0
    notation: int = 0
    swap_kind: bool = False
    swap_words: bool = False
    swap_bytes: bool = False

    @property
    def bits(self) -> float:
        """Bits of the changes: unusual ones have more."""
        return (
            _NEAR_BITS[self.near]
            + _NOTATION_BITS * abs(self.notation)
            + _KIND_BITS * self.swap_kind
            + _WORDS_BITS * self.swap_words
            + _BYTES_BITS * self.swap_bytes
        )

    def of(self, point: RegisterPoint) -> RegisterPoint | None:
        """The changed point; None if it has no such address."""
        kind = OTHER_KIND.get(point.kind, point.kind) if self.swap_kind else point.kind
        address = point.address + self.near + notation_shift(replace(point, kind=kind), self.notation)
        if not 0 <= address <= 65_536 - point.dtype.registers:
            return None
        swap_words = self.swap_words and point.dtype.registers > 1
        return replace(
            point,
            kind=kind,
            address=address,
            word_order=_OPPOSITE[point.word_order] if swap_words else point.word_order,
            byte_order=_OPPOSITE[point.byte_order] if self.swap_bytes else point.byte_order,
        )


def notation_shift(point: RegisterPoint, notation: int) -> int:
    """What the notation adds to the address of a point; a written number states the table in its first digit."""
    if not notation or point.kind.bits:
        return 0
    holding = point.address >= HOLDING_BASE - 1 if notation > 0 else point.kind is Kind.HOLDING
    base = (HOLDING_BASE if holding else INPUT_BASE) + 1 - abs(notation)
    return -base if notation > 0 else base


WRITTEN, COUNTED = (1, 2), (-1, -2)
"""Notations in which a description may write addresses, and in which a device may count them."""


def is_numbered(points: Iterable[RegisterPoint]) -> bool:
    """Whether the addresses of some points look like numbers from 30001 or 40001."""
    addresses = [point.address for point in points if not point.kind.bits]
    return bool(addresses) and min(addresses) >= INPUT_BASE - 1


def variants(notations: tuple[int, ...]) -> Iterator[Variant]:
    """All variants, with few changes first."""
    for notation in (0, *notations):
        for near in _NEAR_BITS if not notation else (0, 1, -1):
            for number in range(8):
                yield Variant(near, notation, bool(number & 1), bool(number & 2), bool(number & 4))


def local_bits(point: RegisterPoint, expected: RegisterPoint) -> float | None:
    """Bits of the changes of one point relative to those of its description.

    Returns:
        None if the address is not near.
    """
    near = _LOCAL_NEAR_BITS.get(point.address - expected.address)
    if near is None:
        return None
    bits = near + (_LOCAL_KIND_BITS if point.kind is not expected.kind else 0.0)
    if point.byte_order is not expected.byte_order:
        bits += _LOCAL_BYTES_BITS
    if point.dtype.registers > 1 and expected.dtype.registers > 1:
        bits += _LOCAL_WORDS_BITS if point.word_order is not expected.word_order else 0.0
    elif point.dtype.registers > 1:
        bits += 1.0  # the description states no order
    return bits + _dtype_bits(point.dtype, expected.dtype)


def _dtype_bits(dtype: DType, expected: DType) -> float:
    if dtype is expected:
        return 0.0
    rare = _RARE_BITS if dtype.registers == 4 else 0.0
    if dtype.is_float != expected.is_float:
        return _FLOAT_BITS + rare + (_RARE_BITS if dtype.registers != expected.registers else 0.0)
    if dtype.registers != expected.registers:
        return _WIDTH_BITS + rare + (0.0 if dtype.is_float or dtype.value[0] == expected.value[0] else _SIGN_BITS)
    return _SIGN_BITS
