"""Dictionary of row effects, one module each: subsets average them, row registration observes them."""

from semlive.model.effects.rows import mains_hum, row_jitter, vibration
from semlive.model.effects.rows.family import RowEffectClass

PERIODIC_EFFECTS: tuple[RowEffectClass, ...] = (mains_hum.FAMILY, vibration.FAMILY)
"""Periodic effects, distinguished by their frequencies."""
ROW_JITTER: RowEffectClass = row_jitter.FAMILY
"""Independent shifts of every row."""
ROW_DICTIONARY: tuple[RowEffectClass, ...] = (*PERIODIC_EFFECTS, ROW_JITTER)


def row_effect(name: str) -> RowEffectClass | None:
    """The row effect of a name; None if there is none."""
    return next((effect for effect in ROW_DICTIONARY if effect.name == name), None)


__all__ = ["PERIODIC_EFFECTS", "ROW_DICTIONARY", "ROW_JITTER", "RowEffectClass", "row_effect"]
