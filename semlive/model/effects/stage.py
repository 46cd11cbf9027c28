"""Effects of the stage, as commanded and fitted moves tell them: maps hold them for moves, and moves are free."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.model.effects.base import NamedEffect
from semlive.model.effects.intensity import IntensityEffectClass, intensity_effect
from semlive.model.effects.load_cell import LoadEffectClass, load_effect
from semlive.model.effects.rows import RowEffectClass, row_effect


@dataclass(frozen=True, slots=True)
class StageEffectClass(NamedEffect):
    """An effect of the stage."""


BACKLASH = StageEffectClass(
    "stage_backlash", "where the stage stops depends on where it came from: m = c + b sign(dc)", "the same places from the other side"
)
QUADRATIC = StageEffectClass(
    "stage_quadratic", "the stage's scale changes along its way: m = c + q c^2", "the same moves about another place"
)
MOVES = (BACKLASH, QUADRATIC)


def non_map_effect(name: str) -> RowEffectClass | StageEffectClass | LoadEffectClass | IntensityEffectClass | None:
    """An effect that another channel than the disparity maps shows; None if it is none."""
    return (
        row_effect(name) or load_effect(name) or intensity_effect(name) or next((effect for effect in MOVES if effect.name == name), None)
    )
