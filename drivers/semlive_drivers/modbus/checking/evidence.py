"""How well registers agree with a number format: the bits that describe them, fewer for what a device is more likely to send. Pure.

Explanations of the same registers are compared by these bits, as in minimum description length. A register that an explanation does not
use counts as any number. The figures are estimates from number formats, not from a collection of devices; docs/validation has what they
achieve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import fmean

from semlive.errors import LinkError
from semlive_drivers.modbus.checking.reader import Register
from semlive_drivers.modbus.codec import decode, number_in
from semlive_drivers.modbus.registers import RegisterPoint

Samples = Mapping[Register, Sequence[int]]
"""Values of each register that was read, in the order of time."""

ZERO_BITS, OTHER_BITS = 0.7, 17.3
"""A register that no point uses: it is 0, or any other number."""
_ZERO_FLOAT_BITS, _ZERO_INTEGER_BITS = 8.0, 5.0
"""A reading of exactly 0: rare with a float, because a sensor has noise."""
_FLOAT_HEAD_BITS = 14.5
"""Sign, exponent of a usual magnitude, and the 7 bits of the mantissa in the first register."""
_ROUND_BITS = 3.3
"""The other registers of the mantissa are 0, as of a round number."""
_SMALLEST, _LARGEST = 1e-15, 1e7
"""Magnitudes beyond which a float is not a reading."""
_FINEST = 1e-7
"""Resolution of a reading relative to the end of its range; smaller numbers cost more bits."""
_JUMP_BITS = 10.0
_JUMP, _JUMP_FLOOR = 0.5, 0.01
"""Change within a second, relative to the value and to the end of its range, that a device without motion does not show."""


def registers_of(point: RegisterPoint, samples: Samples) -> tuple[Register, ...]:
    """The registers of a point; empty if one of them was not read."""
    places = tuple((point.kind, point.address + index) for index in range(point.dtype.registers))
    return places if all(place in samples for place in places) else ()


def first_values(point: RegisterPoint, samples: Samples) -> tuple[int, ...]:
    """The first sample of the registers of a point; empty if one of them was not read."""
    return tuple(samples[place][0] for place in registers_of(point, samples))


def value_of(point: RegisterPoint, samples: Samples, points: Mapping[str, RegisterPoint], index: int = 0) -> float | None:
    """The value of a point.

    Args:
        point: the point.
        samples: registers that were read.
        points: all points by name, for those that determine sign and factors.
        index: which sample.

    Returns:
        None if a register was not read, or the registers hold no reading.
    """
    places = registers_of(point, samples)
    needed = {name: tuple(samples[place][0] for place in registers_of(points[name], samples)) for name in point.needs}
    if not places or not all(needed.values()):
        return None
    try:
        return decode(point, [samples[place][index] for place in places], needed)
    except (LinkError, KeyError):
        return None


def bits_of(point: RegisterPoint, samples: Samples, value: float, largest: float) -> float | None:
    """Bits that describe the registers of a reading in the format of the point.

    Args:
        point: the point; its registers were read.
        samples: registers that were read.
        value: value of the point.
        largest: end of the plausible range, in the unit of the value.

    Returns:
        None for a float that no device sends.
    """
    registers = first_values(point, samples)
    if not any(registers):
        return _ZERO_FLOAT_BITS if point.dtype.is_float else _ZERO_INTEGER_BITS
    number = number_in(point, registers)
    if not point.dtype.is_float:
        return min(2 * math.log2(abs(number) + 1) + 2, 16.0 * len(registers) + 1.0)
    if not _SMALLEST < abs(value) < _LARGEST:
        return None
    last = registers[1:] if point.word_order == "high_first" else registers[:-1]
    tail = _ROUND_BITS if not any(last) else 16.0 * len(last)
    return _FLOAT_HEAD_BITS + tail + max(0.0, 0.5 * math.log2(_FINEST * largest / abs(value)))


def jump_bits(point: RegisterPoint, samples: Samples, points: Mapping[str, RegisterPoint], largest: float) -> float:
    """Bits for changes between the samples that are too large for a device without motion."""
    count = min((len(samples[place]) for place in registers_of(point, samples)), default=0)
    values = [value_of(point, samples, points, index) for index in range(count)]
    if any(value is None for value in values):
        return _JUMP_BITS
    numbers = [value for value in values if value is not None]
    change = max(numbers) - min(numbers)
    return _JUMP_BITS if change > max(_JUMP * max(map(abs, numbers)), _JUMP_FLOOR * largest) else 0.0


def mean_and_noise(point: RegisterPoint, samples: Samples, points: Mapping[str, RegisterPoint]) -> tuple[float, float]:
    """Mean of the samples of a point, of which the first is a number, and their largest difference, in the unit of its value."""
    count = min(len(samples[place]) for place in registers_of(point, samples))
    numbers = [value for index in range(count) if (value := value_of(point, samples, points, index)) is not None]
    return fmean(numbers), max(numbers) - min(numbers)


def unused_bits(place: Register, samples: Samples) -> float:
    """Bits of a register that no point of an explanation uses."""
    return OTHER_BITS if samples[place][0] else ZERO_BITS
