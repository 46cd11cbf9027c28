"""Effect classes of the rows: effects too fast for disparity maps, whose subsets average over rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RowEffectClass:
    """An effect that shifts the image from row to row, or within rows.

    Attributes:
        name: canonical name.
        description: what happens, one sentence.
        discriminating_experiment: the experiment that separates it from confounded effects, one sentence.
        matches_frequency: whether a wave of a frequency, Hz, belongs to the class; None for independent shifts of every row.
        group: group of confounded effects, G1 ... G12, or None.
        sizes_px: smallest and largest expected size, px.
    """

    name: str
    description: str
    discriminating_experiment: str
    matches_frequency: Callable[[float], bool] | None = None
    group: str | None = None
    sizes_px: tuple[float, float] = (0.002, 2.0)
