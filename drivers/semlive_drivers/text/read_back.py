"""Comparison of the settings of a text device with the last order: pure decisions, without IO.

The values are those that a dialogue can read back: the steps of an order with ``equals``, and the questions under ``read_back``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from semlive_drivers.order_exactness import unit_of
from semlive_drivers.text.dialogue import Step


@dataclass(frozen=True, slots=True)
class Value:
    """A value of an order.

    Attributes:
        name: name of the value in the order, such as ``speed_mm_s``, for its unit.
        sent: ordered value.
        tolerance: largest difference of the first answer after the order.
        held: the first answer after the order, which later answers must equal; None before it.
    """

    name: str
    sent: float
    tolerance: float
    held: float | None = None


Memory = Mapping[tuple[str, str], Value]
"""Values by question and group of its reply."""


def values_of(steps: Iterable[Step], values: Mapping[str, float]) -> dict[tuple[str, str], Value]:
    """The values of an order that can be read back, by its steps; names that are not in `values` are skipped."""
    compared_steps = ((step, group, name) for step in steps for group, name in step.equals.items() if name in values)
    return {(step.ask, group): Value(name, values[name], step.tolerance) for step, group, name in compared_steps}


def questions(memory: Memory, excluded: Iterable[str] = ()) -> Sequence[str]:
    """The questions whose answers can be compared, each one time."""
    return sorted({ask for ask, _ in memory} - set(excluded))


def compared(memory: Memory, ask: str, reply: Mapping[str, str | float]) -> tuple[dict[tuple[str, str], Value], str | None]:
    """Compare the answer to a question with the order.

    Returns:
        The memory, and the first difference as part of a message: ``its speed is 0.2 mm/s, 0.05 mm/s was ordered``.
    """
    after, difference = dict(memory), None
    for (question, group), value in memory.items():
        answer = reply.get(group)
        if question != ask or not isinstance(answer, float):
            continue
        if value.held is None and abs(answer - value.sent) <= value.tolerance:
            after[question, group] = replace(value, held=answer)
        elif answer != value.held and difference is None:
            unit, ordered = unit_of(value.name), value.sent if value.held is None else value.held
            difference = f"its {group} is {answer:g} {unit}, {ordered:g} {unit} was ordered"
    return after, difference


def without(memory: Memory, asks: Iterable[str]) -> dict[tuple[str, str], Value]:
    """The memory without the values of some questions."""
    removed = set(asks)
    return {key: value for key, value in memory.items() if key[0] not in removed}
