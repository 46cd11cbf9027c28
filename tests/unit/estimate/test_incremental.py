"""Pairs in any order, solutions from pair to pair, and the linear algebra under them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.estimate.joint.elimination.arrowhead import factorise, sides
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.elimination.shared_parameters import parameter_codes, parameter_indices
from semlive.estimate.joint.elimination.smoother import covariances, distortion_covariance, mean_of, pair_covariances, solve_shared
from semlive.estimate.joint.observations.normal_equations import gradient, marginal, relinearise, reweight
from semlive.estimate.joint.observations.priors import Hyperparameters, gauge_precision, prior_precision
from semlive.estimate.joint.observations.reformulate import reset_model_selection, with_advected_distortion, with_row_shifts
from semlive.estimate.joint.selection.row_term import row_groups
from semlive.estimate.joint.solution.posterior import Solution

from .incremental_runs import GRID, PHASES, SETTINGS, about_of, accumulated, at_once, batch_of, close, maps, named, times, when


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5), (0, 5, 4, 3, 2, 1), (0, 3, 1, 4, 2, 5)])
def test_every_pair_in_any_order_gives_the_batch(order: tuple[int, ...]) -> None:
    state = estimating.init(SETTINGS, GRID, 280, 240)
    for count, pair in enumerate(order, 1):
        state = estimating.update(state, pair, PHASES[pair], times(pair), maps(pair))
        moved = relinearise(state, about_of(state, 3))
        prior = gauge_precision(moved) + prior_precision(moved, Hyperparameters())
        factor = factorise(marginal(moved)[0] + prior, sides(moved))
        near = factor.solve(marginal(moved)[1])
        mean = near + factor.solve(gradient(moved, near) - prior @ near)
        sorted_state = accumulated(tuple(sorted(order[:count])))
        assert sorted_state.drift == state.drift
        batch = relinearise(sorted_state, about_of(sorted_state, 3))
        expected = at_once(batch, gauge_precision(batch) + prior_precision(batch, Hyperparameters()))
        found, required = named(moved, mean), named(batch, expected)
        assert found.keys() == required.keys()
        for name, item in found.items():
            assert np.abs(item - required[name]).max() <= 1e-9 * max(np.abs(required[name]).max(), 1e-3), (order[:count], name)


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5), (0, 5, 4, 3, 2, 1), (0, 3, 1, 4, 2, 5)])
def test_the_newest_pair_and_all_before_it_are_those_of_the_batch(order: tuple[int, ...]) -> None:
    solution = estimating.solve(accumulated(order[:1]))
    state = accumulated(order[:1])
    for pair in order[1:]:
        state = estimating.update(state, pair, PHASES[pair], times(pair), maps(pair))
        solution = estimating.solve_newest(state, solution)
        required = batch_of(solution)
        assert close(named(solution.state, mean_of(solution.shared_posterior)), required)
        filtered = named(solution.state, solution.mean)
        last = max((0, *state.motions.pairs), key=lambda item: times(item)[0].start_s)
        newest = {name: required[name] for name in ("distortion", "axes", *([f"motion {last}"] if last else []))}
        assert close(filtered, newest)
        assert state.drift is not None
        rows = state.drift.rows([when.start_s + 6.0 for when in times(last)])
        knots = state.drift.size
        np.testing.assert_allclose(
            rows @ filtered["drift"][:knots].reshape(-1, 2), rows @ required["drift"][:knots].reshape(-1, 2), atol=1e-8
        )


def test_uncertainty_of_every_pair_is_that_of_the_complete_matrix() -> None:
    solution = estimating.solve(accumulated((0, 3, 1, 4)))
    state = solution.state
    prior = gauge_precision(state) + prior_precision(state, solution.hyper)
    covariance = factorise(marginal(state)[0] * solution.hyper.noise_scale**-2.0 + prior, sides(state)).inverse()
    sigma = np.sqrt(np.diag(covariance))
    ending = solve_shared(solution.shared_posterior.chain)
    found = {item.pair: item for item in pair_covariances(ending)}
    assert sorted(found) == [0, 1, 3, 4]
    for item in found.values():
        assert {*(np.arange(state.layout.size)[state.layout.part("drift")][:8])} <= {*item.index}
        expected = covariance[np.ix_(item.index, item.index)]
        assert np.abs((item.covariance - expected) / sigma[item.index, None] / sigma[item.index]).max() < 1e-6
    part = state.layout.part("distortion")
    assert np.abs((distortion_covariance(ending) - covariance[part, part]) / sigma[part, None] / sigma[part]).max() < 1e-6
    assert np.abs((ending.covariance_of(np.eye(len(sigma))) - covariance) / sigma[:, None] / sigma).max() < 1e-6
    newest = next(pair_covariances(ending, newest=True))
    np.testing.assert_allclose(newest.covariance, found[4].covariance, rtol=1e-9)


def test_a_long_time_without_a_pair_is_bridged_in_steps() -> None:
    state = accumulated((0, 1))
    later = tuple(when(frame, 900.0 + 14.0 * (frame % 2)) for frame in (4, 5))
    state = estimating.update(state, 2, PHASES[2], (later[0], later[1]), maps(2))
    state = relinearise(state, about_of(state, 3))
    prior = gauge_precision(state) + prior_precision(state, Hyperparameters())
    near = factorise(marginal(state)[0] + prior, sides(state)).solve(marginal(state)[1])
    ending = solve_shared(eliminate_all(state, Hyperparameters(), near))
    assert sum(step.pair is None for step in ending.chain.steps) == 1
    assert max(len(step.eliminated) for step in ending.backward_pass()) < 100
    assert close(named(state, mean_of(ending)), named(state, at_once(state, prior)))


def test_pairs_with_shifts_of_rows_are_eliminated_to_what_one_least_squares_gives() -> None:
    order = (0, 1, 2, 3, 4, 5)
    whole = accumulated(order)
    state = with_row_shifts(whole, row_groups(whole), about_of(whole, 3))
    hyper = Hyperparameters(row_shift_px=0.03)
    prior = gauge_precision(state) + prior_precision(state, hyper)
    near = state.linearisation_point + factorise(marginal(state)[0] + prior, sides(state)).solve(
        gradient(state, state.linearisation_point) - prior @ state.linearisation_point
    )
    ending = solve_shared(eliminate_all(state, hyper, near))
    assert close(named(state, mean_of(ending)), named(state, at_once(state, prior)))
    part = state.layout.part("line_shift")
    spread = np.zeros((part.stop - part.start, state.layout.size))
    spread[:, part] = np.eye(part.stop - part.start)
    np.testing.assert_allclose(ending.covariance_of(spread), np.linalg.inv(marginal(state)[0] + prior)[part, part], rtol=1e-5, atol=1e-12)


def test_what_is_made_again_begins_with_nothing_chosen() -> None:
    whole = accumulated((0, 1, 2, 3))
    first = relinearise(whole, about_of(whole, 3))
    chosen = with_row_shifts(with_advected_distortion(first), row_groups(first), first.linearisation_point)
    again = reset_model_selection(chosen, lambda item: item)
    assert (again.distortion.carried, again.row_shifts.size) == (False, 0)
    np.testing.assert_array_equal(again.linearisation_point, first.linearisation_point)
    np.testing.assert_allclose(again.precision, first.precision, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(again.information, first.information, rtol=1e-9, atol=1e-6)


def test_uncertainties_of_one_back_substitution_equal_those_computed_separately() -> None:
    solution = estimating.solve(accumulated((0, 3, 1, 4)))
    layout, rng = solution.state.layout, np.random.default_rng(5)
    touched = {item.pair: item.index for item in pair_covariances(solution.shared_posterior)}
    border = parameter_indices(layout, solution.shared_posterior.chain.border.codes()[: solution.shared_posterior.chain.border.joint_size])
    required = {pair: np.unique(np.concatenate((touched[pair], border))) for pair in (3, 0, 4)}
    rows = {pair: (parameter_codes(layout, index), rng.normal(size=(3, len(index)))) for pair, index in required.items()}
    found = covariances(solution.shared_posterior, rows)
    assert list(found) == [3, 0, 4]
    for pair, (_, own) in rows.items():
        whole = np.zeros((3, layout.size))
        whole[:, required[pair]] = own
        np.testing.assert_allclose(found[pair], solution.covariance_of(whole), rtol=1e-6)
    with pytest.raises(KeyError):
        covariances(solution.shared_posterior, {7: rows[3]})


def test_what_shifts_of_rows_took_off_is_given_back_when_they_are_in_the_model_no_more() -> None:
    plain = estimating.solve(accumulated((0, 1, 2)))
    assert plain.state.row_shifts.size == 0
    shifted = with_row_shifts(plain.state, row_groups(plain.state), plain.mean)
    rng = np.random.default_rng(11)
    mean = np.zeros(shifted.layout.size)
    mean[plain.state.layout.within(shifted.layout)] = plain.mean
    mean[shifted.layout.part("line_shift")] = rng.normal(0, 0.05, shifted.row_shifts.size)
    ending = solve_shared(eliminate_all(shifted, replace(plain.hyper, row_shift_px=0.05), mean))
    with_lines = Solution(shifted, ending.chain.hyper, mean, ending, plain.noise_floor_px)
    dmap = maps(2)[-1]
    reported, now = (estimating.correction_strain(item, dmap) for item in (with_lines, plain))
    moved = estimating.strain_change(plain, reported)
    assert np.abs(reported.value - now.value).max() > 1e-6
    np.testing.assert_allclose([moved.exx, moved.eyy, moved.exy], reported.value - now.value, atol=1e-12)


def test_the_matrix_about_other_parameters_is_that_of_a_new_sum() -> None:
    """Blocks that frame 0 does not show have weight in the map within a pair, whose start time has no part in the noise of frame 0."""
    state = accumulated((0, 1, 2, 3))
    state = reweight(state, tuple(replace(rows, weight=np.maximum(rows.weight, 1e3)) for rows in state.rows))
    moved = relinearise(state, about_of(state, 3))
    starts = moved.layout.part("start_time")
    required = marginal(reweight(moved, moved.rows))[0][starts]
    np.testing.assert_allclose(marginal(moved)[0][starts], required, atol=1e-9 * np.abs(required).max())
