"""Independent shift of every row along x by noise of the scan generator."""

from semlive.model.effects.rows.family import RowEffectClass

FAMILY = RowEffectClass(
    "row_jitter",
    "every row has an independent shift: u += a(frame, row)",
    "pairs with half or twice the dwell: jitter of the scan generator keeps its size, vibration of the column changes with the row time",
)
