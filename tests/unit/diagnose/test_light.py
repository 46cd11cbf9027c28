"""Residual test after every pair: a hidden effect is reported once, and a run without hidden effects gets no report."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from blind.experiment import Conditions, hidden
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.live import followed
from threadpoolctl import threadpool_limits

from semlive import pipeline
from semlive.data.diagnosis.effects import DomainTest
from semlive.data.grid import Grid
from semlive.data.notes import NoteLevel
from semlive.data.settings import AnalysisSettings, EstimateSettings
from semlive.diagnose.fit_tests.adequacy import FALSE_ALARM_RATE, Adequacy, adequacy_after
from semlive.service.analysis.results import new_warnings

GRID = Grid(101, 101, 45, 17, 14, 43)  # a block is a point
Steps = list[tuple[pipeline.AnalysisState, pipeline.PairResult]]


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """As in the daemon's analysis."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def after_each(note: Steps) -> list[Adequacy | None]:
    return [adequacy_after(state.solution, state.pairs) for state, _ in note]


@pytest.fixture(scope="module")
def noise() -> Steps:
    """A run without anything hidden, after each of nine pairs."""
    return list(followed(hidden(Conditions(31, calibration=6, tension=3), (), GRID), AnalysisSettings()))


def test_noise_gives_no_notes(noise: Steps) -> None:
    found = after_each(noise)
    assert found[:4] == [None] * 4
    assert all(one is not None and one.notes() == () for one in found[4:])
    assert min(domain.p_value for one in found[4:] if one for domain in one.where) > 0.01


@pytest.mark.parametrize(("name", "domain", "by"), [("stage_yaw", "frame", 7), ("tilt_with_load", "load", 13)])
def test_a_hidden_effect_is_found_in_its_domain(name: str, domain: str, by: int) -> None:
    conditions = Conditions(7, calibration=8 if by > 8 else by, tension=max(0, by - 8))
    *_, (state, _) = followed(hidden(conditions, hidden_effect(name, 4.0 * PROTOTYPE_PX[name], 7), GRID), AnalysisSettings())
    last = adequacy_after(state.solution, state.pairs)
    assert last is not None
    most_significant = last.most_significant
    assert most_significant is not None
    assert most_significant.domain == domain
    (note,) = last.notes()
    assert f"after {by} pairs" in note.text
    assert most_significant.rms_px > 0.0

    # Once in a run, whatever figures and domain a later look has.
    news, warned = new_warnings((note,), frozenset())
    later = Adequacy(by + 1, (DomainTest("space", 1e-30, 0.1),), 1000.0).notes()
    assert len(news) == 1
    assert "0.1000 px rms, as much as by a strain of 3e-04 over the field" in later[0].text
    assert new_warnings(later, warned)[0] == ()


def test_a_residual_within_the_uncertainty_of_strain_is_no_warning_and_states_its_share_of_the_modulus() -> None:
    found = Adequacy(9, (DomainTest("space", 1e-30, 0.0009),), 780.0)  # as much as a strain of 4.0e-6
    (above,) = found.notes(3.9e-6, 3e-3)
    (unknown,) = found.notes(float("nan"))
    assert above.level is unknown.level is NoteLevel.WARNING
    (within,) = found.notes(4.6e-6, 3e-3)
    assert within.level is NoteLevel.INFORMATION
    assert within.text.endswith("within the stated uncertainty of mean strain (5e-06) and changes Young's modulus by at most 0.1 %")
    (unloaded,) = found.notes(4.6e-6, 2e-5)
    assert unloaded.text.endswith("within the stated uncertainty of mean strain (5e-06)")


def test_all_looks_together_spend_what_is_allowed() -> None:
    spent = [Adequacy(pairs, (), 1000.0).significance_level for pairs in range(5, 10_000)]
    assert 0.999 * FALSE_ALARM_RATE < sum(spent) < FALSE_ALARM_RATE


def test_the_published_method_has_no_such_look() -> None:
    pairs = hidden(Conditions(31, calibration=5, tension=0), (), GRID)
    *_, (state, _) = followed(pairs, AnalysisSettings(estimate=EstimateSettings(method="sutton2007")))
    assert pipeline.residual_notes(state) == ()


def test_values_that_allow_no_look_end_nothing(noise: Steps) -> None:
    state, _ = noise[4]
    assert adequacy_after(state.solution, state.pairs) is not None
    assert adequacy_after(state.solution, state.pairs[:4]) is None
    assert np.isfinite(adequacy_after(state.solution, state.pairs).where[0].p_value)  # type: ignore[union-attr]
