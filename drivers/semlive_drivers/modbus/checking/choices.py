"""Formats, tables and addresses that one measured number may have in place of those in its description. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from semlive_drivers.modbus.checking.evidence import Samples, bits_of, jump_bits, mean_and_noise, value_of
from semlive_drivers.modbus.checking.variants import OTHER_KIND, notation_shift
from semlive_drivers.modbus.registers import DType, Kind, RegisterPoint, WordOrder
from semlive_drivers.panel_reading import PanelReading

_NEAR = (0, 1, -1, 2, -2)
FORCE_UNITS, LENGTH_UNITS = (9.80665, 4.4482216152605), (25.4,)
"""Units other than powers of ten of N (kgf, lbf) and mm (in), in N or mm."""
_LARGEST_BITS_OF_SCALE = 16.0
_OPEN_SCALE_BITS = 4.0
_DEFAULT_LARGEST = 1e4


@dataclass(frozen=True, slots=True)
class Measured:
    """A measured number of a description.

    Attributes:
        name: name of its point.
        plausible: range of a value at rest in the unit of the point; None if the description states none.
        panel: reading of the device's panel in the unit of the point; None without one.
        units: other units in which the device may send the number, in N or mm.
    """

    name: str
    plausible: tuple[float, float] | None = None
    panel: PanelReading | None = None
    units: tuple[float, ...] = (*FORCE_UNITS, *LENGTH_UNITS)

    @property
    def largest(self) -> float:
        """End of the plausible range."""
        return max(map(abs, self.plausible)) if self.plausible else _DEFAULT_LARGEST


@dataclass(frozen=True, slots=True)
class Choice:
    """A point that reads as the device may mean it.

    Attributes:
        point: the point.
        value: its value, in the unit of the described point.
        bits: bits of its registers and of a scale that differs from the described one.
        scale_open: whether the scale is not known: the number format differs and no reading of the panel is given.
    """

    point: RegisterPoint
    value: float
    bits: float
    scale_open: bool = False


def choices(
    measured: Measured, described: RegisterPoint, addresses: Mapping[Kind, set[int]], points: Mapping[str, RegisterPoint], samples: Samples
) -> Iterator[Choice]:
    """All formats at all addresses under which the registers are a possible reading.

    Args:
        measured: the number.
        described: its point in the description.
        addresses: addresses to try, by table.
        points: all described points, for sign and factors.
        samples: registers that were read.
    """
    for kind, tried in addresses.items():
        for address in tried:
            for dtype in _dtypes(described):
                for words, swapped in _orders(dtype, described):
                    if address + dtype.registers > 65_536 or (kind.bits and dtype is not DType.U16):
                        continue
                    point = replace(described, kind=kind, address=address, dtype=dtype, word_order=words, byte_order=swapped)
                    choice = choice_of(measured, described, point, points, samples)
                    if choice is not None:
                        yield choice


def choice_of(
    measured: Measured, described: RegisterPoint, point: RegisterPoint, points: Mapping[str, RegisterPoint], samples: Samples
) -> Choice | None:
    """A point as an explanation of a number, with the best scale; None if it does not agree with range or known reading."""
    format_differs = point.dtype.is_float != described.dtype.is_float
    if format_differs:
        point = replace(point, scale=math.copysign(1.0, described.scale), sentinels=())
    value = value_of(point, samples, points)
    if value is None:
        return None
    bits = bits_of(point, samples, value, measured.largest)
    if bits is None:
        return None
    bits += jump_bits(point, samples, points, measured.largest)
    if measured.panel is not None:
        return _scaled(measured, measured.panel, described, point, mean_and_noise(point, samples, points), bits)
    scale_open = format_differs and not point.dtype.is_float
    if measured.plausible is not None and not scale_open and not measured.plausible[0] <= value <= measured.plausible[1]:
        return None
    return Choice(point, value, bits + _OPEN_SCALE_BITS * scale_open, scale_open)


def _scaled(
    measured: Measured, panel: PanelReading, described: RegisterPoint, point: RegisterPoint, read: tuple[float, float], bits: float
) -> Choice | None:
    """The choice with the simplest scale under which the mean of the samples is the known reading; `read` is mean and noise."""
    mean, noise = read
    raw = mean - point.offset
    for cost, scale in sorted(_scales(measured, described, point, raw, panel.value - point.offset)):
        scaled = raw * scale / point.scale + point.offset
        spread = 2 * noise * abs(scale / point.scale) + (0.0 if point.dtype.is_float else 0.5 * abs(scale))
        if cost <= _LARGEST_BITS_OF_SCALE and panel.agrees(scaled, spread):
            # The registers are those of the panel's reading, within its tolerance: only what remains open must be described.
            resolved = abs(panel.value) / (panel.tolerance + spread) if panel.value else 1.0
            return Choice(replace(point, scale=scale), scaled, max(2.0, bits - math.log2(1.0 + resolved)) + cost)
    return None


def _scales(measured: Measured, described: RegisterPoint, point: RegisterPoint, raw: float, panel: float) -> Iterator[tuple[float, float]]:
    """Scales that may turn a raw value (at the scale of the point) into the known one, each with its bits."""
    format_differs = point.dtype.is_float != described.dtype.is_float
    yield 1.5 if format_differs else 0.0, point.scale
    if not raw or not panel:
        return
    needed = panel / raw * point.scale
    sign = 0.0 if needed * described.scale > 0 else 3.0
    for base in dict.fromkeys((abs(described.scale), 1.0)):
        exponent = round(math.log10(abs(needed) / base))
        if exponent or base != abs(point.scale):
            yield (2.0 if format_differs else 3.0) + sign + 0.4 * abs(exponent), math.copysign(base * 10.0**exponent, needed)
    if sign:
        yield sign, -point.scale
    for unit in measured.units:
        exponent = round(math.log10(abs(needed) / unit))
        yield 7.0 + sign + 0.4 * abs(exponent), math.copysign(unit * 10.0**exponent, needed)
    power = round(math.log2(abs(needed)))
    yield 6.0 + sign + 0.2 * abs(power), math.copysign(2.0**power, needed)


def _dtypes(described: RegisterPoint) -> tuple[DType, ...]:
    """Formats to try; a number with sign and factors from other points, or with bits, keeps its format."""
    if described.needs or described.bit_count or described.kind.bits:
        return (described.dtype,)
    return tuple(DType)


def _orders(dtype: DType, described: RegisterPoint) -> Iterator[tuple[WordOrder, WordOrder]]:
    for byte_order in WordOrder:
        for words in WordOrder if dtype.registers > 1 else (described.word_order,):
            yield words, byte_order


def addresses_around(point: RegisterPoint, notations: tuple[int, ...]) -> dict[Kind, set[int]]:
    """Addresses to try for a point, by table: each table has its own numbers in a notation such as 40001.

    Args:
        point: the described point.
        notations: notations to try, see `variants.notation_shift`.
    """
    kinds = (point.kind, OTHER_KIND[point.kind]) if point.kind in OTHER_KIND else (point.kind,)
    centres = {kind: {point.address + notation_shift(replace(point, kind=kind), one) for one in (0, *notations)} for kind in kinds}
    return {kind: {centre + near for centre in centres[kind] for near in _NEAR if 0 <= centre + near < 65_536} for kind in kinds}
