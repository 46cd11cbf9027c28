"""A hidden effect biases early choices of the estimate: they are made again with that effect in the model."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from blind.cases import ONE, TWO, Case
from blind.observing import QUICK

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.grid import Grid
from semlive.diagnose.baseline.design_matrix import DesignMatrix
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.maps.relinearise import choose_coupling
from semlive.diagnose.maps.verdict import diagnose
from semlive.model.effects import EffectClass

DRAWS = 99
FEW = Grid(101, 101, 45, 17, 14, 43)  # a block is a point


def few(*names: str) -> tuple[EffectClass, ...]:
    """A part of the dictionary: a verdict takes a third of the time."""
    return tuple(effect_class(item) for item in names)


def names_of(found: Diagnosis) -> set[str]:
    return {item.name for item in found.effects}


@pytest.fixture(scope="module")
def tilted() -> Observation:
    return Case(ONE, ("tilt_with_load",), 16.0, 80_001).observed(FEW, QUICK)


def test_a_large_tilt_does_not_make_the_drift_carry_the_distortion(tilted: Observation) -> None:
    dictionary = few("tilt_with_load", "inhomogeneous_strain", "distortion_scale_drift")
    found = diagnose(tilted, dictionary=dictionary, draws=DRAWS)

    assert tilted.state.distortion.carried  # as the estimate has it, and it is not so
    assert not choose_coupling(tilted, dictionary).observation.state.distortion.carried
    assert (found.outcome, names_of(found)) == (Outcome.IDENTIFIED, {"tilt_with_load"})


def test_without_a_hidden_effect_the_choice_is_unchanged() -> None:
    observed = Case(ONE, ("tilt_with_load",), 0.01, 80_001).observed(FEW, QUICK)

    assert choose_coupling(observed, few("tilt_with_load")).observation is observed
    assert not observed.state.distortion.carried


def test_a_distortion_that_drifts_is_made_of_what_it_is_without_the_drift() -> None:
    observed = Case(ONE, ("distortion_scale_drift",), 16.0, 80_004).observed(FEW, QUICK)
    found = diagnose(observed, dictionary=few("distortion_scale_drift", "inhomogeneous_strain"), draws=DRAWS)

    assert (found.outcome, names_of(found)) == (Outcome.IDENTIFIED, {"distortion_scale_drift"})


def test_a_jump_next_to_a_drifting_distortion_gives_no_third_effect() -> None:
    both = ("drift_jump", "distortion_scale_drift")
    found = diagnose(Case(TWO, both, 8.0, 83_028).observed(FEW, QUICK), dictionary=few(*both, "charging_frame_ramp"), draws=DRAWS)

    assert (found.outcome, names_of(found)) == (Outcome.IDENTIFIED, set(both))


def test_amplitudes_of_model_effects_come_first_and_those_of_new_effects_last() -> None:
    columns = cast(Any, SimpleNamespace(sizes_px=np.zeros(2 + 440 + 4)))
    fields = [np.zeros((1, 1, 2, q)) for q in (2, 1, 3)]

    assert DesignMatrix.effect_columns(columns, fields, 1) == (slice(0, 2), slice(442, 443), slice(443, 446))
    assert DesignMatrix.effect_columns(cast(Any, SimpleNamespace(sizes_px=np.zeros(6))), fields, 3) == (
        slice(0, 2),
        slice(2, 3),
        slice(3, 6),
    )
