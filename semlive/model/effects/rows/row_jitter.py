"""Every row lies a little to the left or right of where it should: noise of the scan generator."""

from semlive.model.effects.rows.family import RowEffectClass

FAMILY = RowEffectClass(
    "row_jitter",
    "every row is shifted anew: u += a(frame, row)",
    "pairs with half or twice the dwell: jitter of the scan generator keeps its size, what shakes the column changes with the row time",
)
