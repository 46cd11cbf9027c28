"""Hidden effects are named, nothing is named where nothing is hidden, and a wave that no effect makes has no name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import QUICK, observed

from semlive.data.diagnosis.effects import Outcome
from semlive.data.grid import Grid
from semlive.diagnose.maps.verdict import diagnose
from semlive.model.effects import EFFECT_CLASSES
from semlive_simulators.effects.interfaces import Effect, PixelVisits, Plane

GRID = Grid(101, 101, 45, 17, 14, 43)  # a block is a point
DRAWS = 99
# A seventh of the laws: with all of them a verdict takes twice as long.
FEW = tuple(
    one
    for one in EFFECT_CLASSES
    if one.name in ("magnification_drift", "refocus_magnification_step", "aspect_drift", "tilt_with_load", "dic_subpixel_bias")
)


@dataclass(frozen=True, slots=True)
class MovingWave(Effect):
    """A wave that runs over the field, 0.1 px: nothing in the dictionary does that."""

    name = "moving_wave"

    def offset_px(self, at: PixelVisits) -> Plane:
        """Along x."""
        # Over columns: over rows it would be an oscillation in time, seen once in every frame.
        wave = 0.1 * np.sin(2.0 * np.pi * (at.x_px / 400.0 - at.time_s / 700.0))
        return wave, np.zeros_like(wave)


def test_nothing_is_named_where_nothing_is_hidden() -> None:
    found = diagnose(observed(Conditions(501), (), GRID, QUICK), dictionary=FEW, draws=DRAWS)

    assert found.outcome is Outcome.NONE
    assert found.effects == ()
    assert all(one.p_value > 0.01 for one in found.where)


@pytest.mark.parametrize("name", ["magnification_drift", "tilt_with_load"])
def test_a_hidden_effect_is_named_and_closes_the_gap(name: str) -> None:
    found = diagnose(observed(Conditions(502), hidden_effect(name, 8.0 * PROTOTYPE_PX[name], 1), GRID, QUICK), dictionary=FEW, draws=DRAWS)

    assert found.outcome is Outcome.IDENTIFIED
    assert [one.name for one in found.effects] == [name]
    assert found.gap is not None
    assert found.gap.closure > 0.75
    assert min(one.p_value for one in found.where) < 0.05


def test_what_no_effect_makes_is_not_given_a_name() -> None:
    found = diagnose(observed(Conditions(503), (MovingWave(),), GRID, QUICK), dictionary=FEW, draws=DRAWS)

    assert found.outcome is Outcome.UNKNOWN
