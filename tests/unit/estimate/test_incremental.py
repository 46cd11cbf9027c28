"""Pairs in any order, solutions from pair to pair, and the linear algebra under them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.arrowhead import factorise, marginalise, sides
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.elimination.shared_parameters import parameter_codes, parameter_indices, temporal_splines
from semlive.estimate.joint.elimination.smoother import covariances, distortion_covariance, mean_of, pair_covariances, solve_shared
from semlive.estimate.joint.observations.accumulation import DENSE_PAIRS
from semlive.estimate.joint.observations.block_means import BlockColumns, Blocks, PackedColumns, block_columns
from semlive.estimate.joint.observations.design_columns import map_columns
from semlive.estimate.joint.observations.normal_equations import gradient, marginal, relinearise
from semlive.estimate.joint.observations.priors import Hyperparameters, Smoothness, gauge_precision, prior_precision
from semlive.estimate.joint.observations.reformulate import reset_model_selection, with_advected_distortion, with_row_shifts
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.estimate.joint.selection.long_run import banded_system, log_evidence
from semlive.estimate.joint.selection.row_term import row_groups
from semlive.estimate.joint.solution.posterior import Solution, posterior
from semlive.estimate.joint.solution.solver import selection_due
from semlive.model import Axis, Columns, DistortionSpline, sighting

GRID = Grid(40, 40, 20, 10, 8, 43)
PHASES = (Phase.CALIBRATION, Phase.CALIBRATION, Phase.TRANSLATION, Phase.CALIBRATION, Phase.TENSION, Phase.TENSION)
UNSURE = (0, 2, 3, 5)  # pairs whose frames began a little earlier or later than they are told to have
SETTINGS = EstimateSettings(drift_knots_per_frame=1.0, distortion_knot_px=80.0)


def when(frame: int, start_s: float, sigma_s: float = 0.0) -> FrameTime:
    def known(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    timing = ScanTiming(known(1e-4), known(0.05), known(12.0), Sourced(1, Provenance.CONFIG))
    return FrameTime(frame, start_s, timing, sigma_s)


def times(pair: int) -> tuple[FrameTime, FrameTime]:
    return when(2 * pair, 60.0 * pair), when(2 * pair + 1, 60.0 * pair + 14.0, 0.05 if pair in UNSURE else 0.0)


def exact_times(pair: int) -> tuple[FrameTime, FrameTime]:
    first, second = times(pair)
    return first, replace(second, start_sigma_s=0.0)


def maps(pair: int) -> tuple[DisparityMap, ...]:
    """Drift and a motion, with noise and a tenth of the points missing; the same whenever the pair comes."""
    n = 2 * pair
    wanted = [(n, n + 1)] + ([(0, n), (0, n + 1)] if pair else [])
    shift = np.array([6.0 * np.cos(2.4 * pair), 6.0 * np.sin(2.4 * pair)]) if pair else np.zeros(2)
    found = []
    for reference, current in wanted:
        rng = np.random.default_rng((pair, reference, current))
        drift = 0.02 * (60.0 * (current // 2 - reference // 2) + 14.0 * (current % 2 - reference % 2))
        moved = drift + (shift if reference == 0 else 0.0)
        noise = rng.normal(0, 0.02, (2, *GRID.shape))
        u, v = np.broadcast_to(moved, (2,))[:, None, None] + noise
        status = np.where(rng.random(GRID.shape) < 0.1, PoiStatus.LOW_ZNCC, PoiStatus.CONVERGED).astype(np.uint8)
        sigma = rng.uniform(0.01, 0.03, GRID.shape)
        found.append(DisparityMap(reference, current, GRID, u.copy(), v.copy(), sigma, 1.3 * sigma, np.ones(GRID.shape), status))
    return tuple(found)


def accumulated(order: tuple[int, ...]) -> EstimatorState:
    state = estimating.init(SETTINGS, GRID, 280, 240)
    for pair in order:
        state = estimating.update(state, pair, PHASES[pair], times(pair), maps(pair))
    return state


def about_of(state: EstimatorState, rng_seed: int) -> np.ndarray:
    """A point to linearise about that does not depend on the order of the pairs."""
    about = np.zeros(state.layout.size)
    rng = np.random.default_rng(rng_seed)
    for name in ("distortion", "drift"):
        part = state.layout.part(name)
        about[part] = 0.3 * rng.normal(size=part.stop - part.start)
    start = state.layout.part("motion").start
    for pair in state.motions.pairs:
        part, kind = state.motions.part(pair)
        about[start + part.start : start + part.stop] = 1e-3 * np.random.default_rng((rng_seed, pair)).normal(size=kind.value)
    return about


def at_once(state: EstimatorState, prior: np.ndarray, asked_of: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
    """All rows of all maps in one least squares, noise of frame 0 among its unknowns, nothing integrated out, refined by its rows.

    `asked_of` gives the prior times parameters where the product with the matrix itself would be too coarse.
    """
    n, blocks = state.layout.size, state.blocks.size
    total, rows_of_all = np.zeros((n + 2 * blocks,) * 2), []
    total[:n, :n] = prior
    level = np.zeros((blocks, 2))
    for rows in sorted(state.rows, key=lambda one: (one.current, one.reference)):
        for axis, (index, design) in enumerate(map_columns(state, rows, state.linearisation_point)):
            whole, weight = np.zeros((blocks, n + 2 * blocks)), rows.weight[:, axis]
            whole[:, index] = design
            if rows.reference == 0:
                whole[:, n + axis * blocks : n + (axis + 1) * blocks] = -np.eye(blocks)
                level[:, axis] = np.where(level[:, axis] > 0, level[:, axis], weight)
            total += whole.T @ (whole * weight[:, None])
            rows_of_all.append((whole, weight, rows.disparity_px[:, axis]))
    noise = np.where(level > 0, level, 1.0).T.ravel()
    total[np.arange(n, len(total)), np.arange(n, len(total))] += noise
    scale = 1.0 / np.sqrt(np.diag(total))
    factor = np.linalg.inv(total * scale[:, None] * scale)
    solved = np.zeros(len(total))
    for _ in range(3):
        believed = prior @ solved[:n] if asked_of is None else asked_of(solved[:n])
        asked = -np.concatenate((believed, noise * solved[n:]))
        asked += np.sum([whole.T @ (weight * (value - whole @ solved)) for whole, weight, value in rows_of_all], axis=0)
        solved += factor @ (asked * scale) * scale
    return solved[:n]


def named(state: EstimatorState, parameters: np.ndarray) -> dict[str, np.ndarray]:
    """Parameters by what they mean, whatever the order in which the pairs came."""
    by_pair = ("motion", "start_time")
    found = {name: parameters[state.layout.part(name)] for name, size in state.layout.of_each() if size and name not in by_pair}
    motion, starts = (parameters[state.layout.part(name)] for name in by_pair)
    late = [state.start_time_errors.late_px(2 * pair + 1, starts) for pair in sorted(state.start_time_errors.pairs)]
    found["drift"] = np.concatenate((found["drift"], *late))  # as far as the drift had gone on
    return found | {f"motion {pair}": motion[state.motions.part(pair)[0]] for pair in state.motions.pairs}


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
        found, wanted = named(moved, mean), named(batch, expected)
        assert found.keys() == wanted.keys()
        for name, one in found.items():
            assert np.abs(one - wanted[name]).max() <= 1e-9 * max(np.abs(wanted[name]).max(), 1e-3), (order[:count], name)


def close(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> bool:
    """Within 1e-9 of the largest parameter of each part."""
    return all(np.abs(found[name] - one).max() <= 1e-9 * max(np.abs(one).max(), 1e-3) for name, one in wanted.items())


def batch_of(known: Solution) -> dict[str, np.ndarray]:
    """All rows at once with a solution's choices, linearised where it is."""
    state, border, scale = known.state, known.shared_posterior.chain.border, known.hyper.noise_scale**2
    gauge, belief = gauge_precision(state), prior_precision(state, known.hyper)
    in_time = [
        (parameter_indices(state.layout, one.codes(0, one.spline.size)), one) for one in temporal_splines(state, known.hyper, border)
    ]
    rest = belief.copy()
    for at, _ in in_time:
        rest[np.ix_(at, at)] = 0.0
    rest += gauge

    def asked_of(parameters: np.ndarray) -> np.ndarray:
        """By differences of knots: with third differences of 1e-5 px the product with the matrix loses six digits."""
        total = rest @ parameters
        for at, one in in_time:
            total[at] += one.prior_gradient(0, one.spline.size, parameters[at])
        return total * scale

    return named(state, at_once(state, (gauge + belief) * scale, asked_of))


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5), (0, 5, 4, 3, 2, 1), (0, 3, 1, 4, 2, 5)])
def test_the_newest_pair_and_all_before_it_are_those_of_the_batch(order: tuple[int, ...]) -> None:
    known = estimating.solve(accumulated(order[:1]))
    state = accumulated(order[:1])
    for pair in order[1:]:
        state = estimating.update(state, pair, PHASES[pair], times(pair), maps(pair))
        known = estimating.solve_newest(state, known)
        wanted = batch_of(known)
        assert close(named(known.state, mean_of(known.shared_posterior)), wanted)
        filtered = named(known.state, known.mean)
        last = max((0, *state.motions.pairs), key=lambda one: times(one)[0].start_s)
        newest = {name: wanted[name] for name in ("distortion", "axes", *([f"motion {last}"] if last else []))}
        assert close(filtered, newest)
        assert state.drift is not None
        rows = state.drift.rows([when.start_s + 6.0 for when in times(last)])
        knots = state.drift.size
        np.testing.assert_allclose(
            rows @ filtered["drift"][:knots].reshape(-1, 2), rows @ wanted["drift"][:knots].reshape(-1, 2), atol=1e-8
        )


def test_uncertainty_of_every_pair_is_that_of_the_whole_matrix() -> None:
    known = estimating.solve(accumulated((0, 3, 1, 4)))
    state = known.state
    prior = gauge_precision(state) + prior_precision(state, known.hyper)
    covariance = factorise(marginal(state)[0] * known.hyper.noise_scale**-2.0 + prior, sides(state)).inverse()
    sigma = np.sqrt(np.diag(covariance))
    ending = solve_shared(known.shared_posterior.chain)
    found = {one.pair: one for one in pair_covariances(ending)}
    assert sorted(found) == [0, 1, 3, 4]
    for one in found.values():
        assert {*(np.arange(state.layout.size)[state.layout.part("drift")][:8])} <= {*one.index}
        expected = covariance[np.ix_(one.index, one.index)]
        assert np.abs((one.covariance - expected) / sigma[one.index, None] / sigma[one.index]).max() < 1e-6
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
    again = reset_model_selection(chosen, lambda one: one)
    assert (again.distortion.carried, again.row_shifts.size) == (False, 0)
    np.testing.assert_array_equal(again.linearisation_point, first.linearisation_point)
    np.testing.assert_allclose(again.precision, first.precision, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(again.information, first.information, rtol=1e-9, atol=1e-6)


def test_what_pairs_touch_is_as_uncertain_on_one_way_back_as_asked_one_by_one() -> None:
    known = estimating.solve(accumulated((0, 3, 1, 4)))
    layout, rng = known.state.layout, np.random.default_rng(5)
    touched = {one.pair: one.index for one in pair_covariances(known.shared_posterior)}
    border = parameter_indices(layout, known.shared_posterior.chain.border.codes()[: known.shared_posterior.chain.border.joint_size])
    wanted = {pair: np.unique(np.concatenate((touched[pair], border))) for pair in (3, 0, 4)}
    rows = {pair: (parameter_codes(layout, index), rng.normal(size=(3, len(index)))) for pair, index in wanted.items()}
    found = covariances(known.shared_posterior, rows)
    assert list(found) == [3, 0, 4]
    for pair, (_, own) in rows.items():
        whole = np.zeros((3, layout.size))
        whole[:, wanted[pair]] = own
        np.testing.assert_allclose(found[pair], known.covariance_of(whole), rtol=1e-6)
    with pytest.raises(KeyError):
        covariances(known.shared_posterior, {7: rows[3]})


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
    told, now = (estimating.correction_strain(one, dmap) for one in (with_lines, plain))
    moved = estimating.strain_change(plain, told)
    assert np.abs(told.value - now.value).max() > 1e-6
    np.testing.assert_allclose([moved.exx, moved.eyy, moved.exy], told.value - now.value, atol=1e-12)


def test_a_long_run_makes_its_choices_anew() -> None:
    count = DENSE_PAIRS + 2
    fresh = estimating.init(EstimateSettings(drift_knots_per_frame=0.3, distortion_knot_px=250.0), GRID, 280, 240)
    even = replace(fresh, distortion=DistortionSpline.covering(280, 240, 250.0))  # as few knots at the line start as elsewhere
    n = even.layout.size
    nothing = replace(fresh.reference, coupling=np.zeros((2, fresh.blocks.size, n)))
    state = replace(even, precision=np.zeros((n, n)), information=np.zeros(n), reference=nothing)
    for pair in range(DENSE_PAIRS):
        state = estimating.update(state, pair, Phase.CALIBRATION, exact_times(pair), maps(pair))
    known = estimating.solve(state)
    for pair in range(DENSE_PAIRS, count):
        state = estimating.update(state, pair, Phase.CALIBRATION, exact_times(pair), maps(pair))
    assert not state.summed
    whole = estimating.solve(state)
    assert whole.hyper.rotation_rad != known.hyper.rotation_rad
    assert whole.hyper.noise_scale == pytest.approx(known.hyper.noise_scale, rel=0.02)  # its noise stayed the same
    assert whole.noise_floor_px / known.noise_floor_px == pytest.approx(whole.hyper.noise_scale / known.hyper.noise_scale)
    assert [one.included for one in whole.terms] == [one.included for one in known.terms]
    wanted = batch_of(whole)
    for name, one in named(whole.state, whole.mean).items():  # as stiff as the data choose the drift to be, neither is better than this
        np.testing.assert_allclose(one, wanted[name], atol=1e-7)
    followed = estimating.solve_incremental(state, known)
    part = state.layout.part("distortion")
    sigma = np.sqrt(np.diag(distortion_covariance(whole.shared_posterior)))  # linearised about an earlier solution, so not quite the same
    assert np.abs((followed.mean[part] - whole.mean[part]) / sigma).max() < 0.1
    assert len(estimating.to_estimate(followed, count).motions) == count


def test_choices_given_the_border_weigh_candidates_as_the_whole_matrix_does() -> None:
    state = relinearise(accumulated((0, 1, 2, 3)), about_of(accumulated((0, 1, 2, 3)), 3))
    hypers = [
        replace(Hyperparameters(noise_scale=1.3), drift=(Smoothness(order, size), Smoothness(2, 0.05)), raster_px=(raster, 0.0))
        for order, size, raster in ((2, 0.05, 0.0), (3, 1e-3, 0.0), (2, 0.3, 0.1))
    ]
    nothing = np.zeros(2 * state.blocks.size)
    band = banded_system(state, hypers[0], np.zeros(state.layout.size), nothing)
    local = parameter_indices(state.layout, band.codes)
    in_time = local < state.layout.part("axes").start  # drift and raster
    found, wanted = [], []
    for hyper in hypers:
        believed = (prior_precision(state, hyper) + gauge_precision(state))[np.ix_(local, local)]
        whole, asked = state.precision[np.ix_(local, local)] / 1.3**2 + believed, state.information[local] / 1.3**2
        parts = np.linalg.slogdet(believed[np.ix_(in_time, in_time)])[1], np.linalg.slogdet(whole)[1]
        wanted.append(0.5 * (asked @ np.linalg.solve(whole, asked) + parts[0] - parts[1]))
        found.append(log_evidence(band, hyper))
    np.testing.assert_allclose(np.diff(found), np.diff(wanted), rtol=1e-6)
    near = np.random.default_rng(1).normal(0, 0.01, state.layout.size)
    border = band.border.place(parameter_codes(state.layout, np.arange(state.layout.size))) >= 0
    moved = banded_system(state, hypers[0], np.where(border, 0.0, near), nothing)
    np.testing.assert_allclose(
        [log_evidence(moved, one) - log_evidence(moved, hypers[0]) for one in hypers], np.array(found) - found[0], rtol=1e-6, atol=1e-6
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
    known = estimating.solve(accumulated((0, 1, 2, 3)))
    state = accumulated((0, 1, 2, 3, 4))
    followed = estimating.solve_incremental(state, known)
    assert followed.hyper == known.hyper
    assert followed.terms == known.terms
    prior = gauge_precision(state) + prior_precision(state, known.hyper)
    again = followed.state
    near, factor = posterior(marginal(again), prior, known.hyper.noise_scale)
    asked = gradient(again, near) * known.hyper.noise_scale**-2.0 - prior @ near
    expected = near + np.linalg.solve(factor @ factor.T, asked)
    np.testing.assert_allclose(followed.mean, expected, atol=1e-8)
    spread = np.diag(followed.covariance_of(np.eye(len(expected))))
    np.testing.assert_allclose(spread, np.diag(np.linalg.inv(factor @ factor.T)), rtol=1e-5)


def test_on_the_schedule_and_without_a_solution_before_all_is_chosen_anew() -> None:
    early = estimating.solve(accumulated((0, 1)))
    state = accumulated((0, 1, 2, 3))
    np.testing.assert_array_equal(estimating.solve_incremental(state, early).mean, estimating.solve(state).mean)
    five = accumulated((0, 1, 2, 3, 4))
    np.testing.assert_array_equal(estimating.solve_incremental(five, None).mean, estimating.solve(five).mean)


def test_a_carried_distortion_takes_new_pairs_up() -> None:
    known = estimating.solve(accumulated((0, 1, 2, 3)))
    known = replace(known, state=with_advected_distortion(known.state))
    followed = estimating.solve_incremental(accumulated((0, 1, 2, 3, 4)), known)
    assert followed.state.distortion.carried
    assert sorted(followed.state.motions.pairs) == [1, 2, 3, 4]
    about = replace(followed.state, linearisation_point=followed.mean)
    whole = mean_of(solve_shared(eliminate_all(with_advected_distortion(about), known.hyper, followed.mean)))
    part = about.layout.part("drift")
    assert np.abs(followed.mean[part] - whole[part]).max() < 0.01
    with pytest.raises(IllPosed, match="another run"):
        estimating.solve_incremental(accumulated((0, 1, 2, 4, 5)), known)


def test_the_arrow_factor_is_that_of_the_whole_matrix() -> None:
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
    left, asked = marginalise(whole, information, where, gone)
    expected = np.linalg.inv(inverse[part, part])
    np.testing.assert_allclose(left, expected, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(np.linalg.solve(left, asked), factor.solve(information)[part], atol=1e-5)


@pytest.mark.parametrize("step_px", [5, 50])
def test_block_means_of_a_surface_equal_those_of_its_plain_columns(step_px: int) -> None:
    grid = Grid(30, 30, step_px, 12, 9, 43)
    blocks, distortion = Blocks.of(grid), DistortionSpline.covering(700, 500, 90.0)
    rng = np.random.default_rng(2)
    x, y = (one.ravel() for one in grid.mesh())
    used = rng.random(len(x)) < 0.8
    seen = sighting(when(0, 0.0), x[used] + rng.normal(0, 3, used.sum()), y[used] + rng.normal(0, 3, used.sum()))
    (surface,) = distortion.columns(seen)
    quick = block_columns("distortion", surface, blocks.block[used], blocks.size, sign=-1.0)
    plain = block_columns("distortion", Columns(surface.axis, surface.index, surface.value), blocks.block[used], blocks.size, sign=-1.0)
    spread = np.zeros_like(quick.value)
    spread[:, plain.index] = plain.value
    np.testing.assert_allclose(quick.value, spread, atol=1e-13)
