"""The solution from pair to pair: what the data choose is chosen anew on a geometric schedule, kept in between."""

from __future__ import annotations

import itertools
from dataclasses import replace

from semlive.errors import IllPosed
from semlive.estimate.accumulate import at_rest, beginning, carried_along, dense_pairs, grown, unsummed, update, with_rates
from semlive.estimate.border import DRIFT, NOISE
from semlive.estimate.chain import Chain, chained, extended, looked_at
from semlive.estimate.late import rechosen
from semlive.estimate.late_choices import distortion_rechosen, noise_ratio
from semlive.estimate.late_coupling import coupling_anew, rotation_of
from semlive.estimate.posterior import Solution, choose, solved
from semlive.estimate.smooth import LATELY
from semlive.estimate.state import EstimatorState, rows_of


def follow(state: EstimatorState, known: Solution | None) -> Solution:
    """The solution after a further pair, given that of an earlier one.

    Noise scale, smoothness, optional terms and coupling are chosen anew after 1, 2, 3, 4, 6, 8, 12, 16, 24, ... pairs and kept in
    between: what half as many pairs more can tell of them is little, and choosing takes four times as long as all the rest. It is the
    number of pairs that decides, so a log replayed gives what was said live. Between two choices the result is the exact least
    squares over all maps with these choices, linearised about its own first solution.

    Args:
        state: everything accumulated.
        known: the solution after an earlier pair; None chooses anew.

    Raises:
        IllPosed: there are no data, or they are not finite; or `known` is of pairs that the state does not have.
    """
    if known is None or (chosen_anew(len(state.phases)) and dense_pairs(state) == len(state.phases)):
        return solve(state)
    followed = solved(_gone_on(state, known), known.terms, known.noise_floor_px)
    return _anew(followed, due_before(len(state.phases))) if chosen_anew(len(state.phases)) else followed


def newest(state: EstimatorState, known: Solution, pairs: int = 1) -> Solution:
    """The same for so many newest pairs alone, and for what all pairs share: costs as much after a thousand pairs as after ten.

    The mean of what belongs to earlier pairs stays where the last choice left it.
    """
    return solved(_gone_on(state, known), known.terms, known.noise_floor_px, newest=pairs)


def live(state: EstimatorState, known: Solution | None) -> Solution:
    """What is wanted at once after a further pair: the `LATELY` newest pairs, with the choices that were made before.

    So the first 32 pairs are smoothed whole every time, and of a longer run what is older than that moves when `follow` chooses.
    """
    return solve(state) if known is None else newest(state, known, LATELY)


def _gone_on(state: EstimatorState, known: Solution) -> Chain:
    """The known elimination, with the pairs that it has not seen."""
    chain, before = known.ending.chain, known.state
    if state.motions.pairs[: len(before.motions.pairs)] != before.motions.pairs:
        raise IllPosed("the earlier solution is of another run: begin without one")
    # Drift goes on from where it was found to be; what belongs to the past is in no column that is still to be made.
    local = slice(before.layout.part("drift").start + chain.border.counts[DRIFT], before.layout.part("drift").stop)
    before = replace(before, about=before.about.copy())
    before.about[local] = known.mean[local]
    if before.distortion.carried or before.lines.size:  # columns that a fresh state does not have, so the earlier pairs' are taken over
        state = unsummed(_caught_up(before, state))
    else:
        rows = state.keep.longer(before.rows, state.rows[len(before.rows) :])  # those seen before with the weights that were chosen
        state = replace(state, rows=rows, about=grown(state.layout, before.layout, before.about))
        state = with_rates(unsummed(state), before.starts)
    near = grown(state.layout, before.layout, chain.near)
    new = slice(local.stop, state.layout.part("drift").stop)
    near[new] = state.about[new]
    fresh = state.motions.pairs[len(before.motions.pairs) :]
    return extended(chain, *looked_at(state, near, fresh, chain.border))


def solve(state: EstimatorState) -> Solution:
    """Everything from all pairs; of a run longer than its `dense_pairs`, whether rows are shifted as the first so many that came have it.

    Raises:
        IllPosed: there are no data, or they are not finite.
    """
    first = dense_pairs(state)
    if first == len(state.phases):
        return choose(state)
    known = choose(beginning(state, first))
    return _anew(solved(_gone_on(state, known), known.terms, known.noise_floor_px), first)


def _anew(solution: Solution, since: int) -> Solution:
    """Linearised about the solution itself, with noise, smoothness, coupling, rotations and terms of the raster chosen anew.

    Whether rows are shifted stays as it was. The noise scale is known from the first `since` pairs.
    """
    state, test = with_rates(unsummed(replace(solution.state, about=solution.mean))), coupling_anew(solution, since)
    if test.used:
        state = carried_along(state)
    elif state.distortion.carried:
        state = at_rest(state)
    noise_px = solution.ending.step[solution.ending.chain.border.part(NOISE)]
    larger = noise_ratio(state, solution.mean, noise_px, since)
    turned = rotation_of(state, solution.mean, solution.hyper.rotation_rad)
    hyper = replace(solution.hyper, noise_scale=larger * solution.hyper.noise_scale, rotation_rad=turned)
    before = tuple(test if one.name == test.name else one for one in solution.terms)
    hyper, terms = rechosen(state, hyper, before, solution.mean, noise_px)
    chain = chained(state, hyper, solution.mean)  # eliminates the pairs; the belief about the distortion comes after
    return solved(replace(chain, hyper=distortion_rechosen(chain)), terms, larger * solution.noise_floor_px)


def chosen_anew(pairs: int) -> bool:
    """Whether the number of pairs is a power of two, or one and a half times one."""
    power = 1 << (pairs.bit_length() - 1)
    return pairs in (power, power + power // 2)


def due_before(pairs: int) -> int:
    """The largest number of pairs below this one after which choices were due; 1 for the first."""
    return next((one for one in range(pairs - 1, 0, -1) if chosen_anew(one)), 1)


def _caught_up(known: EstimatorState, state: EstimatorState) -> EstimatorState:
    """The earlier state with the pairs that it has not seen."""
    seen = set(known.motions.pairs)
    for pair, phase in itertools.islice(zip((0, *state.motions.pairs), state.phases, strict=True), 1, None):
        if pair not in seen:
            maps = tuple(rows.dmap for rows in rows_of(state, (pair,)))
            known = update(known, pair, phase, (state.frame_time(2 * pair), state.frame_time(2 * pair + 1)), maps)
    return known
