"""Drift through pauses without its knots: the same prior as with all of them, whatever the length."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.estimate.joint.elimination.shared_parameters import parameter_indices
from semlive.estimate.joint.observations import accumulation
from semlive.estimate.joint.observations.accumulation import RASTER_PAUSE_KNOTS, dense_limit
from semlive.estimate.joint.observations.normal_equations import relinearise
from semlive.estimate.joint.observations.priors import (
    DifferencePenalty,
    Hyperparameters,
    Smoothness,
    gauge_precision,
    prior_precision,
)
from semlive.estimate.joint.selection.long_run import banded_system, log_evidence
from semlive.model import UniformSpline

from .incremental_runs import about_of, accumulated, batch_of, close, named

PAUSE_S = 3600.0  # 300 knots


@pytest.mark.parametrize(
    "penalty", [DifferencePenalty(1, 1.0), Smoothness(2, 1.0).filter, Smoothness(3, 1.0).filter, Smoothness(2, 1.0, 7.0).filter]
)
@pytest.mark.parametrize("skipped", [1, 40])
def test_differences_across_a_gap_have_the_distribution_of_the_walk(penalty: DifferencePenalty, skipped: int) -> None:
    """Its coefficients integrated out of the differences of all give the same precision."""
    retained = np.r_[0:10, 10 + skipped : 20 + skipped]
    every = penalty.rows(20 + skipped).T @ penalty.rows(20 + skipped)
    out = np.setdiff1d(np.arange(20 + skipped), retained)
    eliminated = np.linalg.solve(every[np.ix_(out, out)], every[np.ix_(out, retained)])
    required = every[np.ix_(retained, retained)] - every[np.ix_(retained, out)] @ eliminated
    gaps = [(10, skipped)]
    rows = penalty.rows(20, gaps)
    np.testing.assert_allclose(rows.T @ rows, required, atol=1e-9 * np.abs(required).max())
    value = np.random.default_rng(1).normal(size=20)
    np.testing.assert_allclose(penalty.of(value, gaps), rows @ value, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(penalty.reversed(penalty.of(value, gaps), gaps), rows.T @ rows @ value, rtol=1e-9, atol=1e-7)


def test_a_spline_with_gaps_is_the_spline_on_all_knots() -> None:
    every = UniformSpline(1.0, 2.0, 400)
    some = UniformSpline(1.0, 2.0, 5).after_gap(501.0, 8).until(529.0).after_gap(531.5, 8).after_gap(790.0, 8).until(801.0)
    assert (some.size, some.gaps, some.intervals) == (8 + 17 + 9, ((8, 242), (25, 242 + 127)), 400)
    present = some.place(np.arange(some.size))
    for begin, end in ((1.0, 11.0), (501.0, 529.0), (790.0, 803.0)):  # the last one beyond the end
        at = np.linspace(begin, end, 13)[:-1]
        (index, value), (place, other) = some.local(at), every.local(at)
        np.testing.assert_array_equal(present[index], place)
        np.testing.assert_allclose(value, other, atol=1e-11)
        assert some.has(begin, min(end, 801.0))
        assert present[some.first_at(begin)] == place[0, 0]
    assert not some.has(520.0, 560.0)
    assert some.first_at(600.0) == 25
    assert some.shortened(515.0) == UniformSpline(1.0, 2.0, 5).after_gap(501.0, 8).until(515.0)
    assert some.shortened(700.0) == some.shortened(529.0)
    at = np.array([4.0, 515.0, 800.0])
    assert np.array_equal(some.local(at)[1][1], some.local(at[1:2])[1][0])
    assert some.until(790.0) is some


def test_the_estimate_is_that_with_all_knots(monkeypatch: pytest.MonkeyPatch) -> None:
    without = estimating.solve(accumulated((0, 1, 2, 3), 1000.0))
    monkeypatch.setattr(accumulation, "PAUSE_KNOTS", 10**6)
    every = estimating.solve(accumulated((0, 1, 2, 3), 1000.0))
    assert dense_limit(every.state) == dense_limit(without.state) == 4
    assert len(without.mean) < len(every.mean) - 150
    assert without.hyper.drift == every.hyper.drift
    for one, other in zip(*(estimating.to_estimate(item, 4).motions for item in (without, every)), strict=True):
        if one.pair:
            assert np.all(np.abs(one.shift_px - other.shift_px) < 0.02 * other.shift_sigma_px)
            np.testing.assert_allclose(one.shift_sigma_px, other.shift_sigma_px, rtol=0.02)
            assert np.all(np.abs(one.gradient - other.gradient) <= 1e-3 * other.gradient_sigma)
            np.testing.assert_allclose(one.gradient_sigma, other.gradient_sigma, rtol=1e-3)


def test_the_size_of_the_estimate_does_not_depend_on_the_pause() -> None:
    sizes = {accumulated((0, 1, 2, 3), hours * 3600.0).layout.size for hours in (1.0, 30.0, 300.0)}
    assert len(sizes) == 1
    raster = accumulated((0, 1, 2, 3), 300.0 * 3600.0).raster[0]
    assert raster.size < accumulated((0, 1, 2, 3)).raster[0].size + RASTER_PAUSE_KNOTS


def test_a_pair_within_a_pause_gets_its_knots() -> None:
    """It is as if it had come in its turn, and all pairs at once give the same."""
    solution = None
    for order in ((0, 1, 4), (0, 1, 4, 2), (0, 1, 4, 2, 5)):
        state = accumulated(order, PAUSE_S)
        solution = estimating.solve_newest(state, solution, len(order)) if solution else estimating.solve(state)
        assert state.drift == accumulated(tuple(sorted(order)), PAUSE_S).drift
        if order[-1] != 5:  # solved again, about its own linearisation
            assert close(named(solution.state, solution.mean), batch_of(solution))
    assert solution is not None
    assert len(estimating.to_estimate(solution, 5).motions) == 5


def test_candidates_around_a_pause_are_scored_like_in_the_complete_matrix() -> None:
    state = accumulated((0, 1, 2, 3), 1000.0)
    state = relinearise(state, about_of(state, 3))
    assert state.drift is not None
    assert len(state.drift.spline.gaps) == 1
    hypers = [
        replace(Hyperparameters(noise_scale=1.3), drift=(Smoothness(order, size), Smoothness(2, 0.05)), raster_px=(raster, 0.0))
        for order, size, raster in ((2, 0.05, 0.0), (3, 1e-2, 0.0), (2, 0.3, 0.1))
    ]
    band = banded_system(state, hypers[0], np.zeros(state.layout.size), np.zeros(2 * state.blocks.size))
    local = parameter_indices(state.layout, band.codes)
    in_time = local < state.layout.part("axes").start  # drift and raster
    found, required = [], []
    for hyper in hypers:
        believed = (prior_precision(state, hyper) + gauge_precision(state))[np.ix_(local, local)]
        total, information = state.precision[np.ix_(local, local)] / 1.3**2 + believed, state.information[local] / 1.3**2
        parts = np.linalg.slogdet(believed[np.ix_(in_time, in_time)])[1], np.linalg.slogdet(total)[1]
        required.append(0.5 * (information @ np.linalg.solve(total, information) + parts[0] - parts[1]))
        found.append(log_evidence(band, hyper))
    np.testing.assert_allclose(np.diff(found), np.diff(required), rtol=1e-5)
