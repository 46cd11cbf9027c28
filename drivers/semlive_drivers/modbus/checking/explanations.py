"""Descriptions that explain what a device answers, the most likely one first. Pure.

Each combination of an error of the complete description (`Variant`) with errors of single measured numbers (`Choice`) is weighed by the
bits of its changes and of the registers under it, those included that it does not use (`evidence`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from semlive_drivers.modbus.checking.choices import Choice, Measured, addresses_around, choices
from semlive_drivers.modbus.checking.evidence import Samples, bits_of, first_values, jump_bits, registers_of, unused_bits, value_of
from semlive_drivers.modbus.checking.reader import Register
from semlive_drivers.modbus.checking.variants import Variant, local_bits, variants
from semlive_drivers.modbus.codec import number_in
from semlive_drivers.modbus.device_map import DeviceMap
from semlive_drivers.modbus.registers import Kind, RegisterPoint

FITS_WITHIN_BITS = 9.0
"""An explanation fits if it needs at most so many bits more than the best one: 1/500 of its probability."""
_BEST_OF_EACH = 5
_MISFIT_BITS = 12.0
"""A point, other than the measured numbers, that holds no value its description allows; one description may be wrong in it."""
_UNREAD_BITS = 14.0
_IDENTITY_BITS = 20.0
_OVERLAP_BITS = 8.0
_STATE_BITS = 1.5


@dataclass(frozen=True, slots=True)
class Explanation:
    """A description that agrees with the device.

    Attributes:
        chosen: the measured numbers by name.
        variant: changes of the complete description.
        bits: the fewer, the more likely.
    """

    chosen: Mapping[str, Choice]
    variant: Variant
    bits: float


@dataclass(frozen=True, slots=True)
class Described:
    """A description and its measured numbers.

    Attributes:
        device: the description.
        points: its points with the changes of the configuration.
        measured: the numbers that are explained; at least one.
        notations: notations of addresses to try, see `variants.notations_of`.
    """

    device: DeviceMap
    points: Mapping[str, RegisterPoint]
    measured: tuple[Measured, ...]
    notations: tuple[int, ...] = ()

    def needed(self) -> set[Register]:
        """Registers that the search for explanations needs."""
        found: set[Register] = set()
        for measured in self.measured:
            for kind, addresses in self.addresses(measured).items():
                found |= {(kind, address + index) for address in addresses for index in range(4) if address + index < 65_536}
        for name, point in self.points.items():
            if name in self.read_points():
                for variant in (Variant(near) for near in (0, 1, -1)):
                    changed = variant.of(point)
                    if changed is not None:
                        found |= {(changed.kind, changed.address + index) for index in range(changed.dtype.registers)}
        return found

    def addresses(self, measured: Measured) -> dict[Kind, set[int]]:
        """Addresses at which a measured number is searched."""
        return addresses_around(self.points[measured.name], self.notations)

    def read_points(self) -> set[str]:
        """Points that every reading and the identity need, except the measured numbers."""
        device = self.device
        names = {name for group in device.every_turn for name in group} | {condition.point for condition in device.identity}
        return names - {measured.name for measured in self.measured}


def explain(described: Described, samples: Samples) -> list[Explanation]:
    """All explanations that fit, the most likely one first.

    Args:
        described: the description.
        samples: registers that were read.
    """
    found = {
        measured.name: [
            _rate(choice, samples)
            for choice in choices(measured, described.points[measured.name], described.addresses(measured), described.points, samples)
        ]
        for measured in described.measured
    }
    everything = sum(unused_bits(place, samples) for place in samples)
    best: dict[tuple[RegisterPoint, ...], Explanation] = {}
    for variant in variants(described.notations):
        others_bits, used = _others(described, variant, samples)
        for combination in itertools.product(*(_ranked(found[m.name], described.points[m.name], variant) for m in described.measured)):
            bits = variant.bits + others_bits + everything + _combined_bits(combination, used, samples)
            key = tuple(rated.choice.point for _, rated in combination)
            if key not in best or bits < best[key].bits:
                chosen = {one.name: rated.choice for one, (_, rated) in zip(described.measured, combination, strict=True)}
                best[key] = Explanation(chosen, variant, bits)
    ranked = sorted(best.values(), key=lambda explanation: explanation.bits)
    return [explanation for explanation in ranked if explanation.bits <= ranked[0].bits + FITS_WITHIN_BITS]


@dataclass(frozen=True, slots=True)
class _Rated:
    """A choice with its registers, and its bits less those of the registers as unused ones."""

    choice: Choice
    places: frozenset[Register]
    bits: float


def _rate(choice: Choice, samples: Samples) -> _Rated:
    places = frozenset(registers_of(choice.point, samples))
    return _Rated(choice, places, choice.bits - sum(unused_bits(place, samples) for place in places))


def _ranked(found: Sequence[_Rated], point: RegisterPoint, variant: Variant) -> list[tuple[float, _Rated]]:
    """The best choices of a number under a variant, with the bits of their changes."""
    expected = variant.of(point)
    if expected is None:
        return []
    pairs = [(bits + rated.bits, rated) for rated in found if (bits := local_bits(rated.choice.point, expected)) is not None]
    return sorted(pairs, key=lambda pair: pair[0])[:_BEST_OF_EACH]


def _combined_bits(combination: Sequence[tuple[float, _Rated]], used: set[Register], samples: Samples) -> float:
    """Bits of the measured numbers, with those of registers that two points use."""
    total, taken = 0.0, used
    for bits, rated in combination:
        total += bits
        if twice := rated.places & taken:
            total += _OVERLAP_BITS + sum(unused_bits(place, samples) for place in twice)
        taken = taken | rated.places
    return total


def _others(described: Described, variant: Variant, samples: Samples) -> tuple[float, set[Register]]:
    """Bits of the points other than the measured numbers under a variant, and their registers."""
    changed = {name: moved for name, point in described.points.items() if (moved := variant.of(point)) is not None}
    total, used = 0.0, set[Register]()
    for name in sorted(described.read_points()):
        places = set(registers_of(changed[name], samples)) if name in changed else set[Register]()
        if not places:
            total += _UNREAD_BITS
            continue
        total += _point_bits(described, name, changed, samples) - sum(unused_bits(place, samples) for place in places - used)
        used |= places
    return total, used


def _point_bits(described: Described, name: str, changed: Mapping[str, RegisterPoint], samples: Samples) -> float:
    device, point = described.device, changed[name]
    registers = first_values(point, samples)
    as_unused = sum(unused_bits((point.kind, point.address + index), samples) for index in range(len(registers)))
    conditions = [condition for condition in device.identity if condition.point == name]
    if conditions:
        return 0.0 if all(condition.holds(registers[0]) for condition in conditions) else _IDENTITY_BITS + as_unused
    if device.tells.motion is not None and device.tells.motion.point == name and device.tells.motion.states:
        return _STATE_BITS if registers[0] in device.tells.motion.states else _MISFIT_BITS + as_unused
    value = value_of(point, samples, changed)
    if value is None or (name in device.plausible and not device.plausible[name][0] <= value <= device.plausible[name][1]):
        return _MISFIT_BITS + as_unused
    largest = max(map(abs, device.plausible.get(name, (1e4,))))
    if name == device.tells.counter:
        return min(as_unused, float(int(number_in(point, registers)).bit_length() + 4))
    bits = bits_of(point, samples, value, largest)
    if bits is None:
        return _MISFIT_BITS + as_unused
    return min(bits, as_unused) + (jump_bits(point, samples, changed, largest) if point.dtype.is_float else 0.0)


def as_described(described: Described, explanations: Sequence[Explanation]) -> Explanation | None:
    """The explanation in which every measured number is as the description states it; None if it does not fit."""
    for explanation in explanations:
        if all(choice.point == described.points[name] for name, choice in explanation.chosen.items()):
            return explanation
    return None


def distinct(described: Described, explanations: Sequence[Explanation], samples: Samples) -> Iterator[Explanation]:
    """Explanations that read differently, at some time: not in the sign of long numbers, or in a table with the same registers."""
    keys: set[tuple[RegisterPoint, ...]] = set()
    for explanation in explanations:
        key = tuple(_merged(choice.point, described.points[name], samples) for name, choice in explanation.chosen.items())
        if key not in keys:
            keys.add(key)
            yield explanation


def _merged(point: RegisterPoint, described: RegisterPoint, samples: Samples) -> RegisterPoint:
    """The point, in the described sign and table if it reads the same there.

    An unsigned number of 32 bits or more that was described as signed is too long to be filled. A device may show its registers in both
    tables.
    """
    signed = described.dtype.value.startswith("i") and point.dtype.value == f"u{described.dtype.value[1:]}"
    if signed and point.dtype.registers > 1:
        point = replace(point, dtype=described.dtype)
    other = replace(point, kind=described.kind)
    here, there = ([tuple(samples[place]) for place in registers_of(one, samples)] for one in (point, other))
    return other if here == there and any(any(values) for values in here) else point
