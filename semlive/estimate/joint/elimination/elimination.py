"""Elimination of pairs in order of time. Past parameters are marginalised, so each further pair has the same cost.

Frame 0 is part of every map, so marginalising its noise would couple all pairs. The noise of frame 0, the distortion and the first knots of
drift and raster therefore stay in the parameter vector as a border shared by all pairs. Pairs are then coupled only to the border and to
their neighbours in time. Each step eliminates the parameters that no later pair touches. A front of a few knots and the border remain.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import get_blas_funcs

from semlive.estimate.joint.elimination.arrowhead import cholesky, regularise
from semlive.estimate.joint.elimination.pair_information import (
    PairInformation,
    initial_motion,
    pair_information,
    pair_prior,
    shared_information,
)
from semlive.estimate.joint.elimination.pair_order import (
    first_knot,
    first_later_knots,
    gap_steps,
    knots_end_s,
    last_row_s,
    maps_of,
    pair_times,
)
from semlive.estimate.joint.elimination.shared_parameters import (
    DISTORTION,
    LINES,
    MOTION,
    SHIFT,
    STARTS,
    Codes,
    Matrix,
    SharedParameters,
    TemporalSpline,
    Vector,
    parameter_indices,
    temporal_splines,
)
from semlive.estimate.joint.observations.priors import Hyperparameters
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.estimate.storage import IN_MEMORY, Storage
from semlive.kernels.linear_algebra import forward_substitution

ROWS_PER_BATCH = 256  # rows by which the border is brought up to date at once, which takes a third of the time of one pair after another


@dataclass(frozen=True, slots=True, eq=False)
class EliminationStep:
    """Parameters eliminated in one step.

    Attributes:
        pair: number of the pair; None for knots between pairs.
        eliminated: (g,) codes of the eliminated parameters.
        remaining: (k,) codes of the remaining front.
        factor: (g, g) lower Cholesky factor.
        front_coupling: (g, k) inverse factor times the coupling to the front.
        to_border: (g, b) inverse factor times the coupling to the border.
        pull: (g,) inverse factor times the gradient.
    """

    pair: int | None
    eliminated: Codes
    remaining: Codes
    factor: Matrix
    front_coupling: Matrix
    to_border: Matrix
    pull: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """Information of earlier steps on parameters that later pairs may touch.

    Attributes:
        codes: (k,) sorted codes.
        precision: (k, k) precision.
        shared_coupling: (k, b) coupling to the border.
        gradient: (k,) gradient.
        sizes: number of knots of each temporal spline added so far.
        first_active_knot: first knot of each temporal spline not yet eliminated.
    """

    codes: Codes
    precision: Matrix
    shared_coupling: Matrix
    gradient: Vector
    sizes: tuple[int, ...]
    first_active_knot: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class EliminationChain:
    """Elimination of all pairs so far.

    Attributes:
        state: the data, linearised about its `linearisation_point`.
        linearisation_point: (n,) parameters about which steps are computed; a close point reduces rounding errors.
        hyper: noise scale and prior sizes.
        border: parameters shared by all pairs.
        pairs: numbers of the pairs, in order of time.
        steps: elimination steps, in order of time.
        front: remaining parameters besides the border.
        precision: (b, b) precision of the border after all steps, without priors of the border alone; only the lower triangle is valid.
        gradient: (b,) gradient of the border.
    """

    state: EstimatorState
    linearisation_point: Vector
    hyper: Hyperparameters
    border: SharedParameters
    pairs: tuple[int, ...]
    steps: Sequence[EliminationStep]
    front: Front
    precision: Matrix
    gradient: Vector


def eliminate_all(state: EstimatorState, hyper: Hyperparameters, near: Vector) -> EliminationChain:
    """Eliminate all pairs of a state, linearised at its `linearisation_point`. Solutions are steps from `near` (n,)."""
    border = SharedParameters.of(state)
    splines = temporal_splines(state, hyper, border)
    nothing = np.zeros(0)
    first = tuple(spline.first for spline in splines)
    front = Front(np.zeros(0, dtype=np.int64), np.zeros((0, 0)), np.zeros((0, border.size)), nothing, first, first)
    total = shared_information(state, border, hyper.noise_scale**-2.0) if state.summed else np.zeros((border.size,) * 2)
    empty = EliminationChain(state, near, hyper, border, (), (), front, total, np.zeros(border.size))
    return eliminate_further(empty, state, near, state.summed)


def eliminate_further(chain: EliminationChain, state: EstimatorState, near: Vector, summed: bool = False) -> EliminationChain:
    """Add to a chain the pairs of a state that it does not contain, linearised about the point of the chain.

    A pair after all others has constant cost. A pair that belongs before another requires a new elimination.

    Args:
        chain: earlier elimination of the same run.
        state: the data; its `linearisation_point` holds the point of the chain and, for new parameters, their linearisation point.
        near: (n,) the point of the chain, extended by the new parameters.
        summed: whether the border already contains the information of the new pairs.
    """
    times = pair_times(state)
    order = sorted(times, key=lambda pair: times[pair][0].start_s)
    splines = temporal_splines(state, chain.hyper, chain.border)
    present = set(chain.pairs)
    new = [pair for pair in order if pair not in present]
    if order[: len(chain.pairs)] != list(chain.pairs) or any(
        first_knot(value, times[pair]) < past
        for pair in new
        for value, past in zip(splines, chain.front.first_active_knot, strict=True)
        if chain.pairs
    ):
        return eliminate_all(state, chain.hyper, near)
    maps = maps_of(state, new)
    weight, total, pull = chain.hyper.noise_scale**-2.0, chain.precision.copy(), chain.gradient.copy()
    front, steps, nothing = chain.front, [], _nothing(chain.border)
    later = first_later_knots(splines, [times[pair] for pair in new])
    for pair, limits in zip(new, later, strict=True):
        for gap in gap_steps(splines, front.sizes, front.first_active_knot, times[pair]):
            front, step = _eliminated(front, nothing, splines, gap, (chain, state, near), total, pull, None)
            steps.append(step)
        information = pair_information(state, maps[pair], chain.border, near, None if summed else weight)
        information = replace(
            information,
            **{name: weight * getattr(information, name) for name in ("precision", "shared_coupling", "gradient", "shared_gradient")},
        )
        for shared_rows in information.shared:
            shared_rows.add_to(total, chain.border.counts[DISTORTION])
        pull += information.shared_gradient
        sizes = tuple(max(spline.size_at(knots_end_s(times[pair])), size) for spline, size in zip(splines, front.sizes, strict=True))
        over = (spline.interval(last_row_s(times[pair])) for spline in splines)
        past = tuple(max(min(value, limit), before) for value, limit, before in zip(over, limits, front.first_active_knot, strict=True))
        front, step = _eliminated(front, information, splines, (sizes, past), (chain, state, near), total, pull, pair)
        steps.append(step)
    _bring_up(total, steps)
    return EliminationChain(
        state, near, chain.hyper, chain.border, tuple(order), state.storage.append(chain.steps, steps), front, total, pull
    )


def with_initial_motion(
    state: EstimatorState, near: Vector, pairs: Iterable[int], border: SharedParameters
) -> tuple[EstimatorState, Vector]:
    """Return the state with initial motions of the pairs in its `linearisation_point`, and parameters `near` with the same motions."""
    about, near = state.linearisation_point.copy(), near.copy()
    for maps in maps_of(state, pairs).values():
        index, motion = initial_motion(state, maps, border, near)
        about[index] = near[index] = motion
    return replace(state, linearisation_point=state.storage.store_transient(about)), state.storage.store_transient(near)


def eliminate_last(chain: EliminationChain) -> tuple[EliminationStep, Matrix, Vector]:
    """The last step, after which no front remains, and the precision and gradient of the border after it."""
    total, pull, front = chain.precision.copy(), chain.gradient.copy(), chain.front
    all_past = tuple(size + 1 for size in front.sizes)
    splines = temporal_splines(chain.state, chain.hyper, chain.border)
    _, step = _eliminated(
        front, _nothing(chain.border), splines, (front.sizes, all_past), (chain, chain.state, chain.linearisation_point), total, pull, None
    )
    _bring_up(total, (step,))
    return step, total, pull


def _eliminated(
    front: Front,
    information: PairInformation,
    splines: Sequence[TemporalSpline],
    until: tuple[tuple[int, ...], tuple[int, ...]],
    of: tuple[EliminationChain, EstimatorState, Vector],
    total: Matrix,
    border_pull: Vector,
    pair: int | None,
) -> tuple[Front, EliminationStep]:
    """One step: add new knots with their prior and a pair with its information, then eliminate everything before `until`.

    The prior terms and the gradient of the border are added to `total` and `border_pull` in place. `_bring_up` subtracts the Schur
    complement of the step.
    """
    (sizes, past), (chain, state, near) = until, of
    fresh = [spline.codes(before, size) for spline, before, size in zip(splines, front.sizes, sizes, strict=True)]
    motion, steadiness, prior_gradient = pair_prior(state, near, pair, chain.hyper)
    codes = np.unique(np.concatenate((front.codes, information.codes, motion, *fresh)))
    own, to_border, pull = np.zeros((len(codes),) * 2), np.zeros((len(codes), chain.border.size)), np.zeros(len(codes))
    for source in (front, information):
        at = np.searchsorted(codes, source.codes)
        own[np.ix_(at, at)] += source.precision
        to_border[at] += source.shared_coupling
        pull[at] += source.gradient
    for strand, before, size in zip(splines, front.sizes, sizes, strict=True):
        if size > before:
            about, believed = strand.belief(before, size)
            gradient = strand.prior_gradient(before, size, near[parameter_indices(state.layout, about)])
            _believe((about, believed, gradient), codes, chain.border, (own, to_border, pull), (total, border_pull))
    at = np.searchsorted(codes, motion)
    own[at, at] += steadiness
    pull[at] -= prior_gradient
    out = np.isin(codes >> SHIFT, (MOTION, LINES, STARTS))
    for strand, stop in zip(splines, past, strict=True):
        out |= np.isin(codes, strand.codes(0, stop))
    factor = cholesky(regularise(own[np.ix_(out, out)]))
    right = np.concatenate((own[np.ix_(out, ~out)], to_border[out], pull[out, None]), axis=1)
    solved = np.asfortranarray(forward_substitution(factor, right))  # its parts are contiguous, as a storage needs them
    remaining = int((~out).sum())
    step = EliminationStep(pair, codes[out], codes[~out], factor, solved[:, :remaining], solved[:, remaining:-1], solved[:, -1])
    border_pull -= step.to_border.T @ step.pull
    reduced = own[np.ix_(~out, ~out)] - step.front_coupling.T @ step.front_coupling
    joined = to_border[~out] - step.front_coupling.T @ step.to_border
    front = Front(codes[~out], reduced, joined, pull[~out] - step.front_coupling.T @ step.pull, sizes, past)
    return front, step if state.storage is IN_MEMORY else _stored(step, state.storage)


def _stored(step: EliminationStep, storage: Storage) -> EliminationStep:
    """The step with its arrays moved to a storage; they are most of the memory of a pair."""
    own, front_coupling, border = (storage.store_array(value) for value in (step.factor, step.front_coupling, step.to_border))
    return replace(step, factor=own, front_coupling=front_coupling, to_border=border, pull=step.pull.copy())


def _believe(
    belief: tuple[Codes, Matrix, Vector],
    codes: Codes,
    border: SharedParameters,
    inside: tuple[Matrix, Matrix, Vector],
    outside: tuple[Matrix, Vector],
) -> None:
    """Add, in place, a zero-mean prior to the parameters of a step and to the border."""
    about, believed, gradient = belief
    own, to_border, pull = inside
    place = border.place(about)
    here = place < 0
    at, there = np.searchsorted(codes, about[here]), place[~here]
    own[np.ix_(at, at)] += believed[np.ix_(here, here)]
    pull[at] -= gradient[here]
    if there.size:
        to_border[np.ix_(at, there)] += believed[np.ix_(here, ~here)]
        outside[0][np.ix_(there, there)] += believed[np.ix_(~here, ~here)]
        outside[1][there] -= gradient[~here]


def _bring_up(total: Matrix, steps: Sequence[EliminationStep]) -> None:
    """Subtract, in place, the Schur complements of steps from the lower triangle of the border precision."""
    (syrk,) = get_blas_funcs(("syrk",), (total,))
    pending: list[Matrix] = []
    for number, step in enumerate(steps):
        pending.append(step.to_border)
        if sum(map(len, pending)) >= ROWS_PER_BATCH or number == len(steps) - 1:
            rows = np.concatenate(pending)
            syrk(-1.0, rows.T, beta=1.0, c=total.T, lower=0, overwrite_c=1)  # its upper triangle, transposed: memory runs along rows
            pending = []


def _nothing(border: SharedParameters) -> PairInformation:
    none = np.zeros(0)
    return PairInformation(np.zeros(0, dtype=np.int64), np.zeros((0, 0)), np.zeros((0, border.size)), none, none)
