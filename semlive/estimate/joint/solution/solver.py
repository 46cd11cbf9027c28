"""Solution after each pair. Hyperparameters are selected on a geometric schedule and keep their values between selections."""

from __future__ import annotations

import itertools
from dataclasses import replace

from semlive.errors import IllPosed
from semlive.estimate.joint.elimination.elimination import EliminationChain, eliminate_all, eliminate_further, with_initial_motion
from semlive.estimate.joint.elimination.shared_parameters import DRIFT, NOISE
from semlive.estimate.joint.elimination.smoother import LIVE_WINDOW_PAIRS
from semlive.estimate.joint.observations.accumulation import dense_limit, extended_parameters, first_pairs, update
from semlive.estimate.joint.observations.design_columns import with_rates
from semlive.estimate.joint.observations.normal_equations import without_normal_matrix
from semlive.estimate.joint.observations.reformulate import with_advected_distortion, with_static_distortion
from semlive.estimate.joint.observations.state import EstimatorState, rows_of
from semlive.estimate.joint.selection.long_run import reselect_temporal_terms
from semlive.estimate.joint.selection.long_run_choices import reselect_distortion_smoothness, residual_noise_ratio
from semlive.estimate.joint.solution.advection import reestimate_advection, rms_rotation
from semlive.estimate.joint.solution.posterior import Solution, posterior_from_elimination, select_and_solve


def solve_incremental(state: EstimatorState, previous: Solution | None) -> Solution:
    """Compute the solution after a further pair from an earlier solution.

    Noise scale, smoothness, optional terms and distortion advection are selected after 1, 2, 3, 4, 6, 8, 12, 16, 24, ... pairs. Between
    selections they keep their values, because a selection takes four times as long as the remaining computation. The schedule depends only
    on the number of pairs, so replaying a log reproduces the live results. Between two selections the result is the exact least-squares
    solution over all maps, linearised about its own first solution.

    Args:
        state: the accumulated data.
        previous: the solution after an earlier pair; None selects all hyperparameters.

    Raises:
        IllPosed: there are no data, they are not finite, or `previous` contains pairs that the state does not have.
    """
    if previous is None or not _extends(state, previous) or (selection_due(len(state.phases)) and dense_limit(state) == len(state.phases)):
        return solve(state)
    followed = posterior_from_elimination(_gone_on(state, previous), previous.terms, previous.noise_floor_px)
    return _selected_again(followed, previous_selection(len(state.phases))) if selection_due(len(state.phases)) else followed


def solve_newest(state: EstimatorState, previous: Solution, pairs: int = 1) -> Solution:
    """Update only the newest `pairs` pairs and the shared parameters. The cost does not depend on the length of the run.

    The mean of the parameters of earlier pairs keeps its value from the last selection.
    """
    if not _extends(state, previous):
        return solve(state)
    return posterior_from_elimination(_gone_on(state, previous), previous.terms, previous.noise_floor_px, newest=pairs)


def solve_live(state: EstimatorState, previous: Solution | None) -> Solution:
    """Compute the solution needed immediately after a pair: the newest `LIVE_WINDOW_PAIRS` pairs with the previous hyperparameters.

    The first 32 pairs are therefore all smoothed after each pair. In a longer run, older pairs change when `solve_incremental`
    makes a selection.
    """
    return solve(state) if previous is None else solve_newest(state, previous, LIVE_WINDOW_PAIRS)


def _extends(state: EstimatorState, previous: Solution) -> bool:
    """Whether no pair came within a pause whose knots the previous solution lacks."""
    before, now = ([one.spline for one in (of.drift, *of.raster) if one] for of in (previous.state, state))
    return all(spline.of_intervals(earlier.intervals) == earlier for earlier, spline in zip(before, now, strict=True))


def _gone_on(state: EstimatorState, previous: Solution) -> EliminationChain:
    """The previous elimination, extended by the pairs it does not contain."""
    chain, before = previous.shared_posterior.chain, previous.state
    if state.motions.pairs[: len(before.motions.pairs)] != before.motions.pairs:
        raise IllPosed("the earlier solution is of another run: begin without one")
    # The drift continues from its estimate; columns not yet computed do not depend on the past.
    local = slice(before.layout.part("drift").start + chain.border.counts[DRIFT], before.layout.part("drift").stop)
    before = replace(before, linearisation_point=before.linearisation_point.copy())
    before.linearisation_point[local] = previous.mean[local]
    if (
        before.distortion.carried or before.row_shifts.size
    ):  # columns that a fresh state does not have, so the earlier pairs' are taken over
        state = without_normal_matrix(_caught_up(before, state))
    else:
        rows = state.storage.append(before.rows, state.rows[len(before.rows) :])  # pairs of the earlier state keep their robust weights
        state = replace(state, rows=rows, linearisation_point=extended_parameters(state, before.layout, before.linearisation_point))
        state = with_rates(without_normal_matrix(state), before.start_time_errors)
    near = extended_parameters(state, before.layout, chain.linearisation_point)
    new = slice(local.stop, state.layout.part("drift").stop)
    near[new] = state.linearisation_point[new]
    fresh = state.motions.pairs[len(before.motions.pairs) :]
    return eliminate_further(chain, *with_initial_motion(state, near, fresh, chain.border))


def solve(state: EstimatorState) -> Solution:
    """Compute the full solution from all pairs.

    In a run longer than its `dense_limit`, the test for row shifts uses only the first pairs in order of arrival.

    Raises:
        IllPosed: there are no data, or they are not finite.
    """
    first = dense_limit(state)
    if first == len(state.phases):
        return select_and_solve(state)
    previous = select_and_solve(first_pairs(state, first))
    return _selected_again(posterior_from_elimination(_gone_on(state, previous), previous.terms, previous.noise_floor_px), first)


def _selected_again(solution: Solution, since: int) -> Solution:
    """Linearise about the solution and select noise, smoothness, advection, rotation size and raster terms again.

    The test for row shifts is not repeated. The noise scale is that of the first `since` pairs times the ratio of the residuals.
    """
    state, test = (
        with_rates(without_normal_matrix(replace(solution.state, linearisation_point=solution.mean))),
        reestimate_advection(solution, since),
    )
    if test.included:
        state = with_advected_distortion(state)
    elif state.distortion.carried:
        state = with_static_distortion(state)
    noise_px = solution.shared_posterior.step[solution.shared_posterior.chain.border.part(NOISE)]
    larger = residual_noise_ratio(state, solution.mean, noise_px, since)
    turned = rms_rotation(state, solution.mean, solution.hyper.rotation_rad)
    hyper = replace(solution.hyper, noise_scale=larger * solution.hyper.noise_scale, rotation_rad=turned)
    before = tuple(test if term.name == test.name else term for term in solution.terms)
    hyper, terms = reselect_temporal_terms(state, hyper, before, solution.mean, noise_px)
    chain = eliminate_all(state, hyper, solution.mean)  # eliminates the pairs; the prior of the distortion follows
    return posterior_from_elimination(replace(chain, hyper=reselect_distortion_smoothness(chain)), terms, larger * solution.noise_floor_px)


def selection_due(pairs: int) -> bool:
    """Whether the number of pairs is a power of two, or one and a half times one."""
    power = 1 << (pairs.bit_length() - 1)
    return pairs in (power, power + power // 2)


def previous_selection(pairs: int) -> int:
    """Largest number of pairs below `pairs` at which a selection was due; 1 for the first."""
    return next((count for count in range(pairs - 1, 0, -1) if selection_due(count)), 1)


def _caught_up(previous: EstimatorState, state: EstimatorState) -> EstimatorState:
    """The earlier state with the pairs it does not contain."""
    present = set(previous.motions.pairs)
    for pair, phase in itertools.islice(zip((0, *state.motions.pairs), state.phases, strict=True), 1, None):
        if pair not in present:
            maps = tuple(rows.dmap for rows in rows_of(state, (pair,)))
            previous = update(previous, pair, phase, (state.frame_time(2 * pair), state.frame_time(2 * pair + 1)), maps)
    return previous
