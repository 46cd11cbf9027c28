"""Effects of the stage, as commanded and fitted moves tell them: maps hold them for moves, and moves are free."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.model.grey_effects import GreyFamily, of_grey
from semlive.model.load_effects import LoadFamily, of_loads
from semlive.model.named import Named
from semlive.model.row_effects import RowFamily, of_rows


@dataclass(frozen=True, slots=True)
class MoveFamily(Named):
    """An effect of the stage."""


BACKLASH = MoveFamily(
    "stage_backlash", "where the stage stops depends on where it came from: m = c + b sign(dc)", "the same places from the other side"
)
QUADRATIC = MoveFamily("stage_quadratic", "the stage's scale changes along its way: m = c + q c^2", "the same moves about another place")
MOVES = (BACKLASH, QUADRATIC)


def beside_maps(name: str) -> RowFamily | MoveFamily | LoadFamily | GreyFamily | None:
    """An effect that another channel than the disparity maps shows; None if it is none."""
    return of_rows(name) or of_loads(name) or of_grey(name) or next((one for one in MOVES if one.name == name), None)
