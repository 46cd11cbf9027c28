"""Orders that a dialogue describes: their values, and whether its requests can hold them. Needs no line."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from semlive.errors import LinkError
from semlive_drivers.device_part import PartCommand
from semlive_drivers.text.codec import fill_template, step_of
from semlive_drivers.text.dialogue import TextProtocol


def order_values(order: PartCommand, values: Mapping[str, float], extension_mm: float) -> dict[str, float]:
    """The values of an order, and those that a dialogue may use in their place.

    Args:
        order: the order.
        values: as of `Part.command`.
        extension_mm: extension at the last reading, from which the end of a motion is counted.

    Returns:
        The values, with ``speed_mm_min``, ``rate_n_min`` and ``to_mm`` where they follow from them.
    """
    derived = dict(values)
    if "speed_mm_s" in derived:
        derived["speed_mm_min"] = derived["speed_mm_s"] * 60.0
    if "rate_n_s" in derived:
        derived["rate_n_min"] = derived["rate_n_s"] * 60.0
    if "travel_mm" in derived:
        derived["to_mm"] = extension_mm + (derived["travel_mm"] if order is PartCommand.JOG_TENSION else -derived["travel_mm"])
    return derived


class TextOrders:
    """The orders of a dialogue, as `semlive_drivers.device_part.OrderBook`.

    Args:
        dialogue: the description.
        all_values: gives all values that the requests of an order may use, as `order_values`.
    """

    def __init__(self, dialogue: TextProtocol, all_values: Callable[[PartCommand, Mapping[str, float]], Mapping[str, float]]) -> None:
        self._dialogue, self._all_values = dialogue, all_values
        self.can = frozenset(dialogue.orders)

    def order_problem(self, order: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why an order cannot be given exactly, or None; sends nothing and never raises."""
        try:
            self.require_exact(order, self._all_values(order, values))
        except LinkError as error:
            return str(error)
        return None

    def require_exact(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Raise LinkError if the number format of a request does not hold a value of the order exactly enough."""
        for step in self._dialogue.orders.get(order, ()):
            fill_template(step.send, values)

    def step_of(self, value: str) -> float:
        """Smallest step of ``travel_mm`` or ``speed_mm_s`` in orders in tension; 0 where a motion is ordered by its end position."""
        steps = self._dialogue.orders.get(PartCommand.JOG_TENSION, ())
        per_minute = value.replace("_mm_s", "_mm_min")
        return max((max(step_of(step.send, value), step_of(step.send, per_minute) / 60.0) for step in steps), default=0.0)
