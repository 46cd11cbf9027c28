"""Effects of rows that can be named: one file each. Maps of subsets cannot see them, registration of rows does."""

from semlive.model.effects.rows import mains_hum, row_jitter, vibration
from semlive.model.effects.rows.family import RowEffectClass

PERIODIC_EFFECTS: tuple[RowEffectClass, ...] = (mains_hum.FAMILY, vibration.FAMILY)
"""Waves in time, each with frequencies of its own."""
ROW_JITTER: RowEffectClass = row_jitter.FAMILY
"""Shifts that are anew in every row."""
ROW_DICTIONARY: tuple[RowEffectClass, ...] = (*PERIODIC_EFFECTS, ROW_JITTER)


def row_effect(name: str) -> RowEffectClass | None:
    """The effect of rows of a name; None if it is none."""
    return next((effect for effect in ROW_DICTIONARY if effect.name == name), None)


__all__ = ["PERIODIC_EFFECTS", "ROW_DICTIONARY", "ROW_JITTER", "RowEffectClass", "row_effect"]
