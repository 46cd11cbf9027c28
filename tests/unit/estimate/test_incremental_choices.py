"""Choices of hyperparameters and terms in long runs, and what they are made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.arrowhead import factorise, marginalise, sides
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.elimination.shared_parameters import parameter_codes, parameter_indices
from semlive.estimate.joint.elimination.smoother import distortion_covariance, mean_of, solve_shared
from semlive.estimate.joint.observations.accumulation import DENSE_PAIRS
from semlive.estimate.joint.observations.block_means import BlockColumns, Blocks, PackedColumns, block_columns
from semlive.estimate.joint.observations.normal_equations import gradient, marginal, relinearise
from semlive.estimate.joint.observations.priors import Hyperparameters, Smoothness, gauge_precision, prior_precision
from semlive.estimate.joint.observations.reformulate import with_advected_distortion
from semlive.estimate.joint.selection.long_run import banded_system, log_evidence
from semlive.estimate.joint.solution.posterior import posterior
from semlive.estimate.joint.solution.solver import selection_due
from semlive.model import Axis, Columns, DistortionSpline, sighting

from .incremental_runs import GRID, about_of, accumulated, batch_of, exact_times, maps, named, when


def test_a_long_run_makes_its_choices_again() -> None:
    count = DENSE_PAIRS + 2
    fresh = estimating.init(EstimateSettings(drift_knots_per_frame=0.3, distortion_knot_px=250.0), GRID, 280, 240)
    even = replace(fresh, distortion=DistortionSpline.covering(280, 240, 250.0))  # as few knots at the line start as elsewhere
    n = even.layout.size
    nothing = replace(fresh.reference, coupling=np.zeros((2, fresh.blocks.size, n)))
    state = replace(even, precision=np.zeros((n, n)), information=np.zeros(n), reference=nothing)
    for pair in range(DENSE_PAIRS):
        state = estimating.update(state, pair, Phase.CALIBRATION, exact_times(pair), maps(pair))
    solution = estimating.solve(state)
    for pair in range(DENSE_PAIRS, count):
        state = estimating.update(state, pair, Phase.CALIBRATION, exact_times(pair), maps(pair))
    assert not state.summed
    whole = estimating.solve(state)
    assert whole.hyper.rotation_rad != solution.hyper.rotation_rad
    assert whole.hyper.noise_scale == pytest.approx(solution.hyper.noise_scale, rel=0.02)  # its noise stayed the same
    assert whole.noise_floor_px / solution.noise_floor_px == pytest.approx(whole.hyper.noise_scale / solution.hyper.noise_scale)
    assert [item.included for item in whole.terms] == [item.included for item in solution.terms]
    required = batch_of(whole)
    for name, item in named(whole.state, whole.mean).items():  # as stiff as the data choose the drift to be, neither is better than this
        np.testing.assert_allclose(item, required[name], atol=1e-7)
    followed = estimating.solve_incremental(state, solution)
    part = state.layout.part("distortion")
    sigma = np.sqrt(np.diag(distortion_covariance(whole.shared_posterior)))  # linearised about an earlier solution, so not quite the same
    assert np.abs((followed.mean[part] - whole.mean[part]) / sigma).max() < 0.1
    assert len(estimating.to_estimate(followed, count).motions) == count


def test_choices_given_the_border_score_candidates_like_the_complete_matrix() -> None:
    state = relinearise(accumulated((0, 1, 2, 3)), about_of(accumulated((0, 1, 2, 3)), 3))
    hypers = [
        replace(Hyperparameters(noise_scale=1.3), drift=(Smoothness(order, size), Smoothness(2, 0.05)), raster_px=(raster, 0.0))
        for order, size, raster in ((2, 0.05, 0.0), (3, 1e-3, 0.0), (2, 0.3, 0.1))
    ]
    nothing = np.zeros(2 * state.blocks.size)
    band = banded_system(state, hypers[0], np.zeros(state.layout.size), nothing)
    local = parameter_indices(state.layout, band.codes)
    in_time = local < state.layout.part("axes").start  # drift and raster
    found, required = [], []
    for hyper in hypers:
        believed = (prior_precision(state, hyper) + gauge_precision(state))[np.ix_(local, local)]
        whole, requests = state.precision[np.ix_(local, local)] / 1.3**2 + believed, state.information[local] / 1.3**2
        parts = np.linalg.slogdet(believed[np.ix_(in_time, in_time)])[1], np.linalg.slogdet(whole)[1]
        required.append(0.5 * (requests @ np.linalg.solve(whole, requests) + parts[0] - parts[1]))
        found.append(log_evidence(band, hyper))
    np.testing.assert_allclose(np.diff(found), np.diff(required), rtol=1e-6)
    near = np.random.default_rng(1).normal(0, 0.01, state.layout.size)
    border = band.border.place(parameter_codes(state.layout, np.arange(state.layout.size))) >= 0
    moved = banded_system(state, hypers[0], np.where(border, 0.0, near), nothing)
    np.testing.assert_allclose(
        [log_evidence(moved, item) - log_evidence(moved, hypers[0]) for item in hypers], np.array(found) - found[0], rtol=1e-6, atol=1e-6
    )


def test_packed_columns_hold_what_they_were_made_of() -> None:
    rng = np.random.default_rng(4)
    full = np.zeros((5, 9, 11))
    for block in full[:4]:
        y, x = rng.integers(0, 6), rng.integers(0, 7)
        block[y : y + 3, x : x + 4] = rng.normal(size=(3, 4))
    packed = PackedColumns.of(BlockColumns("distortion", Axis.EACH, np.arange(99), full.reshape(5, -1)), (9, 11))
    assert packed.window.shape == (5, 3, 4)
    np.testing.assert_array_equal(packed.unpacked().value, full.reshape(5, -1))


def test_choices_are_made_at_powers_of_two_and_half_way_between() -> None:
    assert [n for n in range(1, 50) if selection_due(n)] == [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48]


def test_between_choices_the_data_decide_everything_but_the_choices() -> None:
    solution = estimating.solve(accumulated((0, 1, 2, 3)))
    state = accumulated((0, 1, 2, 3, 4))
    followed = estimating.solve_incremental(state, solution)
    assert followed.hyper == solution.hyper
    assert followed.terms == solution.terms
    prior = gauge_precision(state) + prior_precision(state, solution.hyper)
    again = followed.state
    near, factor = posterior(marginal(again), prior, solution.hyper.noise_scale)
    requests = gradient(again, near) * solution.hyper.noise_scale**-2.0 - prior @ near
    expected = near + np.linalg.solve(factor @ factor.T, requests)
    np.testing.assert_allclose(followed.mean, expected, atol=1e-8)
    spread = np.diag(followed.covariance_of(np.eye(len(expected))))
    np.testing.assert_allclose(spread, np.diag(np.linalg.inv(factor @ factor.T)), rtol=1e-5)


def test_on_the_schedule_and_without_a_solution_before_all_is_chosen_again() -> None:
    early = estimating.solve(accumulated((0, 1)))
    state = accumulated((0, 1, 2, 3))
    np.testing.assert_array_equal(estimating.solve_incremental(state, early).mean, estimating.solve(state).mean)
    five = accumulated((0, 1, 2, 3, 4))
    np.testing.assert_array_equal(estimating.solve_incremental(five, None).mean, estimating.solve(five).mean)


def test_a_carried_distortion_takes_new_pairs_up() -> None:
    solution = estimating.solve(accumulated((0, 1, 2, 3)))
    solution = replace(solution, state=with_advected_distortion(solution.state))
    followed = estimating.solve_incremental(accumulated((0, 1, 2, 3, 4)), solution)
    assert followed.state.distortion.carried
    assert sorted(followed.state.motions.pairs) == [1, 2, 3, 4]
    about = replace(followed.state, linearisation_point=followed.mean)
    whole = mean_of(solve_shared(eliminate_all(with_advected_distortion(about), solution.hyper, followed.mean)))
    part = about.layout.part("drift")
    assert np.abs(followed.mean[part] - whole[part]).max() < 0.01
    with pytest.raises(IllPosed, match="another run"):
        estimating.solve_incremental(accumulated((0, 1, 2, 4, 5)), solution)


def test_the_arrow_factor_is_that_of_the_complete_matrix() -> None:
    state = accumulated((0, 1, 2, 3, 4))
    precision, information = marginal(state)
    whole = precision + gauge_precision(state) + prior_precision(state, Hyperparameters())
    where = sides(state)
    assert not whole[np.ix_(where.x, where.y)].any()
    factor = factorise(whole, where)
    scale = 1.0 / np.sqrt(np.diag(whole))
    inverse = np.linalg.inv(whole * scale[:, None] * scale) * scale[:, None] * scale
    spread = np.sqrt(np.diag(inverse))
    assert np.abs((factor.inverse() - inverse) / spread[:, None] / spread).max() < 1e-6
    np.testing.assert_allclose(factor.solve(information), factor.inverse() @ information, atol=1e-5)
    half = factor.half(np.column_stack((information, whole[:, 7])))
    np.testing.assert_allclose(half.T @ half[:, 0], np.stack((information, whole[:, 7])) @ factor.solve(information), rtol=1e-6)
    scaled = np.linalg.slogdet(whole * scale[:, None] * scale)[1] - 2.0 * np.sum(np.log(scale))
    assert factor.half_log_det == pytest.approx(0.5 * scaled, abs=1e-4)
    part = state.layout.part("drift")
    gone = np.ones(len(whole), dtype=bool)
    gone[part] = False
    reduced, requests = marginalise(whole, information, where, gone)
    expected = np.linalg.inv(inverse[part, part])
    np.testing.assert_allclose(reduced, expected, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(np.linalg.solve(reduced, requests), factor.solve(information)[part], atol=1e-5)


@pytest.mark.parametrize("step_px", [5, 50])
def test_block_means_of_a_surface_equal_those_of_its_plain_columns(step_px: int) -> None:
    grid = Grid(30, 30, step_px, 12, 9, 43)
    blocks, distortion = Blocks.of(grid), DistortionSpline.covering(700, 500, 90.0)
    rng = np.random.default_rng(2)
    x, y = (item.ravel() for item in grid.mesh())
    used = rng.random(len(x)) < 0.8
    observed = sighting(when(0, 0.0), x[used] + rng.normal(0, 3, used.sum()), y[used] + rng.normal(0, 3, used.sum()))
    (surface,) = distortion.columns(observed)
    quick = block_columns("distortion", surface, blocks.block[used], blocks.size, sign=-1.0)
    plain = block_columns("distortion", Columns(surface.axis, surface.index, surface.value), blocks.block[used], blocks.size, sign=-1.0)
    spread = np.zeros_like(quick.value)
    spread[:, plain.index] = plain.value
    np.testing.assert_allclose(quick.value, spread, atol=1e-13)
