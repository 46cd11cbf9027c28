"""Explanations as text: what differs from the description, and the values that follow. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from semlive_drivers.modbus.checking.choices import Choice
from semlive_drivers.modbus.checking.explanations import Explanation
from semlive_drivers.modbus.registers import Kind, RegisterPoint, WordOrder

_FUNCTION = {Kind.INPUT: 4, Kind.HOLDING: 3, Kind.COIL: 1, Kind.DISCRETE: 2}


def order_name(point: RegisterPoint) -> str:
    """Order of the registers and bytes of a point: ``low word first``."""
    swapped = point.byte_order is WordOrder.LOW_FIRST
    if point.dtype.registers == 1:
        return "bytes swapped" if swapped else ""
    words = "high word first" if point.word_order is WordOrder.HIGH_FIRST else "low word first"
    return f"{words}, bytes swapped" if swapped else words


def changes(choice: Choice, described: RegisterPoint) -> list[str]:
    """What differs from the description, with the order of the registers in any case."""
    point, found = choice.point, []
    if point.address != described.address:
        difference = point.address - described.address
        found.append(f"address {'+' if difference > 0 else '-'} {abs(difference)}")
    if point.kind is not described.kind:
        found.append(
            f"{point.kind.entry_name} instead of {described.kind.entry_name} "
            f"(function code {_FUNCTION[point.kind]} instead of {_FUNCTION[described.kind]})"
        )
    if point.dtype is not described.dtype:
        found.append(f"{point.dtype} instead of {described.dtype}")
    if order := order_name(point):
        found.append(order)
    if point.scale != described.scale:
        found.append(f"scale {point.scale:.6g} instead of {described.scale:.6g}")
    if choice.scale_open:
        found.append("scale not panel")
    return found


def layout(explanation: Explanation, points: Mapping[str, RegisterPoint]) -> str:
    """The explanation relative to the description: ``address + 1, high word first``."""
    parts = {name: ", ".join(changes(choice, points[name])) or "as described" for name, choice in explanation.chosen.items()}
    if len(set(parts.values())) == 1:
        return f"{', '.join(parts)}: {next(iter(parts.values()))}"
    return "; ".join(f"{name}: {text}" for name, text in parts.items())


def values(explanation: Explanation, units: Mapping[str, str]) -> str:
    """The values that follow, with where they are: ``force 123.456 N (input register 1)``."""
    return ", ".join(
        f"{name} {choice.value:.7g} {units.get(name, '')}".rstrip() + f" ({choice.point.kind.entry_name} {choice.point.address})"
        for name, choice in explanation.chosen.items()
    )


def correction(explanation: Explanation, points: Mapping[str, RegisterPoint]) -> str:
    """The lines of the description that would be right: ``force: {kind: input, address: 1, dtype: f32}``."""
    texts = []
    for name, choice in explanation.chosen.items():
        point = choice.point
        if point == points[name]:
            continue
        fields = [f"kind: {point.kind}", f"address: {point.address}", f"dtype: {point.dtype}"]
        if point.dtype.registers > 1:
            fields.append(f"words: {point.word_order}")
        if point.byte_order is WordOrder.LOW_FIRST:
            fields.append("byte_order: low_first")
        if point.scale != 1.0:
            fields.append(f"scale: {point.scale:.10g}")
        texts.append(f"{name}: {{{', '.join(fields)}}}")
    return "; ".join(texts)
