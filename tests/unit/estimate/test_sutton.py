"""The published procedure's parts against functions that they must find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numexp.cases import CASES
from numexp.experiment import Experiment, Taken, make_experiment
from numexp.lens_distortion import fit_lens_distortion

from semlive import pipeline
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import FrameTime
from semlive.data.experiment import Step
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.scan import Provenance, Sourced
from semlive.data.settings import AnalysisSettings, EstimateSettings
from semlive.errors import IllPosed
from semlive.estimate import sutton
from semlive.estimate.sutton.surface import Surface

GRID = Grid(101, 101, 25, 30, 24, 43)


@pytest.fixture(scope="module")
def equation_9() -> Experiment:
    return make_experiment(CASES["paper_exact"], 3, GRID)


def given(experiment: Experiment, settings: EstimateSettings, pairs: int = 99) -> sutton.SuttonState:
    state = sutton.init(settings, experiment.grid, 1024, 884)
    for one in experiment.pairs[:pairs]:
        state = sutton.update(state, one.pair, one.phase, one.times, one.maps)
    return state


def test_the_papers_world_without_noise_is_found(equation_9: Experiment) -> None:
    """Drift is quadratic, so its velocity is in the spline; the residual is the wave between knots."""
    solution = sutton.solve(given(equation_9, EstimateSettings()))
    found = sutton.to_estimate(solution, 3)
    assert found.drift.drift_px == pytest.approx(equation_9.world.column.drift.at(found.drift.time_s), abs=1e-3)
    assert found.drift.revision == 3
    for one in equation_9.pairs[1:]:
        for observed in one.observed:
            correction = sutton.correction(solution, observed.exact)
            residual_px = observed.exact.u_px - correction.u_px - observed.displacement_px[..., 0]
            assert np.ptp(residual_px) <= 2e-3
    assert found.distortion.valid.all()
    assert solution.noise_floor_px <= 1e-3


def test_pairs_that_are_missing_points_still_give_drift_everywhere(equation_9: Experiment) -> None:
    state = given(equation_9, EstimateSettings(sutton_smoothing_px=0.0))
    full = sutton.solve(state)
    holes = tuple(replace(one, maps=tuple(_with_hole(dmap) for dmap in one.maps)) for one in state.pairs)
    holed = sutton.solve(replace(state, pairs=holes))
    observed = equation_9.pairs[5].observed[1].exact
    difference = sutton.correction(full, observed).v_px - sutton.correction(holed, observed).v_px
    assert np.abs(difference - difference.mean()).max() <= 5e-3


def _with_hole(dmap: DisparityMap) -> DisparityMap:
    status = dmap.status.copy()
    status[4:7, 10:14] = PoiStatus.LOW_ZNCC
    return replace(dmap, status=status)


def test_one_pair_gives_drift_and_reports_what_it_cannot(equation_9: Experiment) -> None:
    solution = sutton.solve(given(equation_9, EstimateSettings(), pairs=1))
    found = sutton.to_estimate(solution, 1)
    assert not found.distortion.valid.any()
    assert any("distortion not determined" in note.text for note in found.notes)
    with pytest.raises(IllPosed, match="no translated image"):
        fit_lens_distortion(solution)


def test_what_is_missing_is_reported() -> None:
    with pytest.raises(IllPosed, match="no pair"):
        sutton.solve(sutton.init(EstimateSettings(), GRID, 1024, 884))
    with pytest.raises(ValueError, match="joint or sutton2007"):
        EstimateSettings(method="newton")


def test_a_surface_is_the_spline_that_it_was_given() -> None:
    surface = Surface.flat(np.array([0.0, 10.0]), np.array([300.0, 210.0]), 100.0)
    at = np.random.default_rng(1).uniform([0.0, 10.0], [300.0, 210.0], (50, 2))
    ones = replace(surface, coefficients=np.ones_like(surface.coefficients))
    assert ones.at(at) == pytest.approx(1.0)
    assert np.asarray(surface.rows(at).sum(axis=1)) == pytest.approx(1.0)


def test_classical_forms_have_a_centre_and_miss_a_wave(equation_9: Experiment) -> None:
    fit = fit_lens_distortion(sutton.solve(given(equation_9, EstimateSettings())))
    assert fit.at(np.array([[511.5, 441.5]])) == pytest.approx(0.0)
    assert fit.residual_px > 1e-3


def test_the_pipeline_estimates_by_the_method_that_the_settings_name(equation_9: Experiment) -> None:
    settings = AnalysisSettings(estimate=EstimateSettings(method="sutton2007"))
    decisions = [decision(one) for one in equation_9.pairs]
    started = pipeline.start_from_maps(settings, decisions[0].first, GRID)
    for one, taken in zip(equation_9.pairs, decisions, strict=True):
        started = pipeline.accumulate(started, taken, one.maps)
    result = pipeline.finalise(started)
    assert "published procedure" in result.messages[0]
    assert len(result.frames) == 30
    assert max(abs(one.summary.mean.eyy) for one in result.frames) <= 1e-6


def decision(one: Taken) -> PairDecision:
    def info(when: FrameTime) -> FrameInfo:
        start = Sourced(round(when.start_s * 1e9), Provenance.CONFIG)
        pixel = Sourced(1.25e-6, Provenance.CONFIG)
        return FrameInfo(when.frame, f"{when.frame}.tif", "plain", 1024, 884, 0, when.timing, start, 0.01, pixel)

    step = Step(one.pair, one.phase, (0.0, 0.0), (0.0, 0.0), None)
    return PairDecision(one.pair, step, info(one.times[0]), info(one.times[1]), None)
