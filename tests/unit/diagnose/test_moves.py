"""Backlash and a nonlinear scale are found from commanded and measured moves; other stage errors are not."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.data.diagnosis.effects import ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.scalars.stage import StageMoves, add_stage_evidence

CROSS = [0, 16, -8, 32, -24, 8, -32, 24, 0]
PLACES = np.array([(x, 0) for x in CROSS] + [(0, y) for y in CROSS[1:]], dtype=np.float64)
NOTHING = Diagnosis(Outcome.NONE, (), (), None, None, None, (), 0.01)


def moves(seed: int, backlash_px: float = 0.0, quadratic_per_px: float = 0.0) -> StageMoves:
    """A stage with a scale and an angle of its own, drift, and 0.24 px of noise."""
    rng = np.random.default_rng(seed)
    late = np.linspace(0.0, 1.0, len(PLACES))[:, None]
    went = PLACES @ np.array([[1.01, 0.01], [-0.01, 0.99]]) + late * [3.0, -5.0] + 0.24 * rng.standard_normal(PLACES.shape)
    reported = StageMoves(PLACES, went)
    return StageMoves(PLACES, went + backlash_px * reported.direction + quadratic_per_px * PLACES**2)


def test_no_stage_is_given_an_effect_that_it_has_not() -> None:
    found = [add_stage_evidence(NOTHING, moves(seed)) for seed in range(150)]
    assert sum(bool(entry.effects) for entry in found) == 0
    assert np.mean([entry.where[-1].p_value < 0.05 for entry in found]) == pytest.approx(0.05, abs=0.04)


@pytest.mark.parametrize(("name", "size"), [("stage_backlash", {"backlash_px": 1.3}), ("stage_quadratic", {"quadratic_per_px": 2e-3})])
def test_what_a_stage_does_has_a_name(name: str, size: dict[str, float]) -> None:
    found = [add_stage_evidence(NOTHING, moves(seed, **size)) for seed in range(40)]
    assert all([effect.name for effect in entry.effects] == [name] for entry in found)
    (true,) = size.values()
    away = [(item.value - true) / item.sigma for entry in found for effect in entry.effects for item in effect.parameters]
    assert np.std(away) == pytest.approx(1.0, abs=0.3)  # of 80, with ten degrees of freedom each
    assert abs(np.mean(away)) < 0.4


def test_effects_of_the_model_and_too_few_moves_give_no_finding() -> None:
    with_backlash = Diagnosis(Outcome.NONE, (), (), None, None, None, (), 0.01, model_effects=(ModelEffect("stage_backlash", (), 0.8),))
    assert add_stage_evidence(with_backlash, moves(1, backlash_px=0.8)).effects == ()
    few = moves(1, backlash_px=5.0)
    assert add_stage_evidence(NOTHING, StageMoves(few.commanded_px[:7], few.fitted_px[:7])) is NOTHING
    still = StageMoves(np.zeros((12, 2)), few.fitted_px[:12])
    assert add_stage_evidence(NOTHING, still) is NOTHING
