"""Effects of rows that can be named: one file each. Maps of subsets cannot see them, registration of rows does."""

from semlive.model.row_effects import mains_hum, row_jitter, vibration
from semlive.model.row_effects.family import RowFamily

WAVES: tuple[RowFamily, ...] = (mains_hum.FAMILY, vibration.FAMILY)
"""Waves in time, each with frequencies of its own."""
ANEW: RowFamily = row_jitter.FAMILY
"""Shifts that are anew in every row."""
ROW_DICTIONARY: tuple[RowFamily, ...] = (*WAVES, ANEW)


def of_rows(name: str) -> RowFamily | None:
    """The effect of rows of a name; None if it is none."""
    return next((one for one in ROW_DICTIONARY if one.name == name), None)


__all__ = ["ANEW", "ROW_DICTIONARY", "WAVES", "RowFamily", "of_rows"]
