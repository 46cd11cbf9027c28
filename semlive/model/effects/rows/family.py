"""What a nameable effect of rows is: too fast for disparity maps, whose subsets average it away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RowEffectClass:
    """An effect that shifts the picture from row to row, or within rows.

    Attributes:
        name: canonical.
        description: what happens, one sentence.
        discriminating_experiment: the experiment that tells it from its like, one sentence.
        matches_frequency: whether a wave of so many Hz is called so; None where there is no wave and every row is shifted anew.
        group: of effects that it is confounded with, G1 ... G12, or None.
        sizes_px: the least and the largest size that is expected.
    """

    name: str
    description: str
    discriminating_experiment: str
    matches_frequency: Callable[[float], bool] | None = None
    group: str | None = None
    sizes_px: tuple[float, float] = (0.002, 2.0)
