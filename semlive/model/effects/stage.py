"""Effects of the stage, observed as differences of commanded and fitted moves; the maps alone fit them as specimen motion."""

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
    "stage_backlash",
    "the final position depends on the direction of approach: m = c + b sign(dc)",
    "the same positions approached from the other side",
)
QUADRATIC = StageEffectClass(
    "stage_quadratic", "the scale of the stage depends on its position: m = c + q c^2", "the same moves about another position"
)
MOVES = (BACKLASH, QUADRATIC)


def non_map_effect(name: str) -> RowEffectClass | StageEffectClass | LoadEffectClass | IntensityEffectClass | None:
    """The effect of a name that is observed in another channel than the disparity maps; None if there is none."""
    return (
        row_effect(name) or load_effect(name) or intensity_effect(name) or next((effect for effect in MOVES if effect.name == name), None)
    )
