"""Criteria of a verdict: identified effects are UNKNOWN where the residual with them is not noise."""

from __future__ import annotations

import pytest
from blind.experiment import Conditions
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import QUICK, observed

from semlive.data.diagnosis.effects import DomainTest
from semlive.data.diagnosis.misfit_reason import MisfitCriterion, MisfitReason
from semlive.data.diagnosis.verdict import AdequacyTest
from semlive.data.grid import Grid
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.fit_tests.spatial_lines import SPATIAL_LINES
from semlive.diagnose.maps.repeated_search import SearchResult, repeated_search, residual_adequacy
from semlive.diagnose.maps.verdict import _unexplained

NO_LINES = DomainTest(SPATIAL_LINES, 1.0, 0.0)
NAME = "magnification_drift"


@pytest.fixture(scope="module")
def result() -> SearchResult:
    effects = hidden_effect(NAME, 8.0 * PROTOTYPE_PX[NAME], 7)
    observation = observed(Conditions(7, calibration=5, tension=0), effects, Grid(101, 101, 45, 17, 14, 43), QUICK)
    return repeated_search(observation, [effect_class(NAME)], (), (99, 0))


def test_an_adequate_residual_is_no_reason(result: SearchResult) -> None:
    adequacy = residual_adequacy(result, ())
    assert [effect.names[0] for effect in result.effects] == [NAME]
    assert adequacy is not None
    assert adequacy.passed
    assert _unexplained(result, NO_LINES, adequacy) == ()


def test_a_residual_that_is_not_noise_is_a_reason(result: SearchResult) -> None:
    adequacy = AdequacyTest("scan_time", 3e-7, 0.02, 1e-4)
    assert _unexplained(result, NO_LINES, adequacy) == (MisfitReason(MisfitCriterion.ADEQUACY, "scan_time", 3e-7),)


def test_waves_over_the_field_are_a_reason(result: SearchResult) -> None:
    lines = DomainTest(SPATIAL_LINES, 1e-5, 0.01)
    assert _unexplained(result, lines, None) == (MisfitReason(MisfitCriterion.SPATIAL_LINES, value=1e-5),)
