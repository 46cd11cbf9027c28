"""Selection of the smoothness of temporal parameters in a long run, from all pairs, conditional on the shared parameters.

The full marginal likelihood needs all pairs in one dense matrix. After dozens of pairs, distortion, scan axes and noise of frame 0 are
known more precisely than the drift of any single pair. If they are treated as known, the remaining matrix of drift, raster and motions
is banded in time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from semlive.data.drift import TermTest
from semlive.estimate.joint.elimination.pair_information import pair_information, pair_prior
from semlive.estimate.joint.elimination.pair_order import KNOT_MARGIN
from semlive.estimate.joint.elimination.shared_parameters import (
    DRIFT,
    NOISE,
    Codes,
    Matrix,
    SharedParameters,
    TemporalSpline,
    Vector,
    parameter_indices,
    temporal_splines,
)
from semlive.estimate.joint.observations.accumulation import PAUSE_KNOTS
from semlive.estimate.joint.observations.priors import Hyperparameters, Kind
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations, rows_of
from semlive.estimate.joint.selection.band_prior import coupled_knots, log_determinant, prior_band
from semlive.estimate.joint.selection.marginal_likelihood import CANDIDATES, DRIFT_ORDERS, log_prior, smoothness_of_kind
from semlive.estimate.joint.selection.model_selection import MIN_BAYES_FACTOR, RASTER_CANDIDATES

SAMPLE_SEGMENTS = 4
"""Number of segments of neighbouring pairs from which the smoothness of a long run is selected."""
PAIRS_PER_SEGMENT = 24
"""Pairs of one segment: about 160 knots, which determine a smoothness well enough."""


@dataclass(frozen=True, slots=True, eq=False)
class BandedSystem:
    """Normal equations of all temporal parameters, conditional on the shared parameters.

    Attributes:
        state: the data.
        pairs: numbers of the pairs, in order of time.
        border: the shared parameters, treated as known.
        near: (n,) joint parameters about which steps are computed; the shared ones hold their estimate.
        codes: (m,) parameter codes, latest first. Frame 0 fixes the start of the run and the end is free, so pivots stay large.
        precision: (w + 1, m) lower band of the precision of the data and of the priors of motions.
        pull: (m,) gradient of the log-likelihood and of the priors of motions.
    """

    state: EstimatorState
    pairs: tuple[int, ...]
    border: SharedParameters
    near: Vector
    codes: Codes
    precision: Matrix
    pull: Vector

    def strands(self, hyper: Hyperparameters) -> tuple[TemporalSpline, ...]:
        """Temporal splines of the band; those of the drift start at the first knot touched, earlier knots keep their values from `near`."""
        return _strands(self.state, self.pairs, hyper, self.border)

    def place(self, codes: Codes) -> NDArray[np.int64]:
        """Positions of codes; -1 for shared parameters."""
        order = np.argsort(self.codes)
        return np.where(self.border.place(codes) < 0, order[np.minimum(np.searchsorted(self.codes[order], codes), len(order) - 1)], -1)


def reselect_temporal_terms(
    state: EstimatorState, hyper: Hyperparameters, terms: tuple[TermTest, ...], near: Vector, noise_px: Vector
) -> tuple[Hyperparameters, tuple[TermTest, ...]]:
    """Select the smoothness of the drift and the raster terms again; all other hyperparameters keep their values.

    A long run uses segments distributed evenly over it, so the cost does not grow with the run.

    Args:
        state: the data, linearised about `near`.
        hyper: the hyperparameters selected before.
        terms: the terms tested before.
        near: (n,) estimate of the joint parameters.
        noise_px: (2 blocks,) estimate of the noise of frame 0, px, first x, then y.
    """
    bands = [banded_system(state, hyper, near, noise_px, stretch) for stretch in sampled_pairs(state)]
    for axis in (0, 1):
        hyper = _climbed(bands, hyper, axis)
    tests = {term.name: term for term in terms}
    for number, change in enumerate(state.raster):
        sizes = [0.0, *(float(value) for value in RASTER_CANDIDATES)]
        options = [
            replace(hyper, raster_px=tuple(size if i == number else value for i, value in enumerate(hyper.raster_px))) for size in sizes
        ]
        scores = np.array([sum(log_evidence(band, option) for band in bands) for option in options])
        best = int(np.argmax(scores[1:])) + 1
        gain = float(scores[best] - scores[0])
        hyper = options[best if gain > MIN_BAYES_FACTOR else 0]
        if change.name in tests:
            tests[change.name] = replace(tests[change.name], included=gain > MIN_BAYES_FACTOR, evidence=gain)
    return hyper, tuple(tests.values())


def sampled_pairs(state: EstimatorState) -> list[tuple[int, ...]]:
    """Numbers of all pairs in order of time, or of `SAMPLE_SEGMENTS` evenly distributed segments of `PAIRS_PER_SEGMENT` pairs."""
    every = tuple(dict.fromkeys(when.frame // 2 for when in state.frames))
    if len(every) <= SAMPLE_SEGMENTS * PAIRS_PER_SEGMENT:
        return split_at_pauses(state, every)
    first = np.linspace(0, len(every) - PAIRS_PER_SEGMENT, SAMPLE_SEGMENTS).astype(int)
    return [part for begin in first for part in split_at_pauses(state, every[begin : begin + PAIRS_PER_SEGMENT])]


def split_at_pauses(state: EstimatorState, pairs: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Split pairs in order of time where more than `PAUSE_KNOTS` drift knots lie between two of them.

    The drift before such a pause is irrelevant. In one band with 15 hours of pause all digits were lost, and the values of knots before it,
    which are known, would bind those after it too little for double precision.
    """
    assert state.drift is not None  # there are pairs
    begin_s, end_s = {}, {}
    for when in state.frames:
        begin_s.setdefault(when.frame // 2, when.start_s)
        end_s[when.frame // 2] = when.start_s + when.timing.duration_s
    pause_s = PAUSE_KNOTS * state.drift.spline.spacing
    cuts = [at for at in range(1, len(pairs)) if begin_s[pairs[at]] - end_s[pairs[at - 1]] > pause_s]
    return [pairs[begin:end] for begin, end in zip((0, *cuts), (*cuts, len(pairs)), strict=True)]


def banded_system(
    state: EstimatorState, hyper: Hyperparameters, near: Vector, noise_px: Vector, pairs: tuple[int, ...] | None = None
) -> BandedSystem:
    """Banded system of neighbouring pairs (default: all), with the noise scale and the motion priors of `hyper`."""
    border, weight = SharedParameters.of(state), hyper.noise_scale**-2.0
    pairs = tuple(dict.fromkeys(when.frame // 2 for when in state.frames)) if pairs is None else pairs
    codes = _in_order(state, pairs, hyper, border)
    empty = BandedSystem(state, pairs, border, near, codes, np.zeros((1, len(codes))), np.zeros(len(codes)))
    maps: dict[int, list[MapObservations]] = {}
    for rows in rows_of(state, pairs):
        maps.setdefault(rows.current // 2, []).append(rows)
    terms = []
    for _, pair_maps in sorted(maps.items()):
        information = pair_information(state, pair_maps, border, near)
        pull = information.gradient - information.shared_coupling[:, border.part(NOISE)] @ noise_px
        terms.append((empty.place(information.codes), weight * information.precision, weight * pull))
    width = max((int(np.ptp(at)) for at, _, _ in terms if at.size), default=0)
    for strand in empty.strands(hyper):
        at, reach = empty.place(strand.codes(strand.first, strand.spline.size)), coupled_knots(strand)
        width = max(width, int((at[:-reach] - at[reach:]).max(initial=0)))
    precision, pull = np.zeros((width + 1, len(codes))), np.zeros(len(codes))
    for at, own, gradient in terms:
        lower = at[:, None] >= at[None, :]
        precision[(at[:, None] - at[None, :])[lower], np.broadcast_to(at, own.shape)[lower]] += own[lower]
        pull[at] += gradient
    for pair in pairs:
        own, believed, gradient = pair_prior(state, near, pair, hyper)
        at = empty.place(own)
        precision[0, at] += believed
        pull[at] -= gradient
    return replace(empty, precision=precision, pull=pull)


def with_prior(band: BandedSystem, hyper: Hyperparameters) -> tuple[Matrix, Vector, float]:
    """Precision and gradient of a band including the priors of drift and raster, and the log prior density at `near`."""
    precision, pull, total = band.precision.copy(), band.pull.copy(), 0.0
    for strand in band.strands(hyper):
        codes = strand.codes(0, strand.spline.size)
        value = band.near[parameter_indices(band.state.layout, codes)]
        own, cost = prior_band(strand, value)
        begin, gradient = strand.first, strand.prior_gradient(strand.first, strand.spline.size, value[strand.since(strand.first) :])
        at = band.place(codes[begin:][::-1])
        for lag in range(len(own)):
            count = own.shape[1] - lag
            precision[at[lag:] - at[:count], at[:count]] += own[lag, :count]
        pull[at] -= gradient[begin - strand.since(begin) :][::-1]
        total += log_determinant(strand) - cost
    return precision, pull, total


def log_evidence(band: BandedSystem, hyper: Hyperparameters) -> float:
    """Log marginal likelihood, up to a constant common to all candidates."""
    precision, pull, total = with_prior(band, hyper)
    try:
        factor = cholesky_banded(precision, lower=True, check_finite=False)
    except LinAlgError:  # the stiffness exceeds the precision of a double relative to the free directions
        return -np.inf
    fit = float(pull @ cho_solve_banded((factor, True), pull, check_finite=False))
    return 0.5 * (total + fit - 2.0 * float(np.log(factor[0]).sum()))


def _climbed(bands: list[BandedSystem], hyper: Hyperparameters, axis: int) -> Hyperparameters:
    """Most likely smoothness of one component of the drift.

    The search moves from size to size while the likelihood increases, for the current kind and for the neighbours of the best kind.
    """
    scores: dict[tuple[Kind, int], tuple[float, Hyperparameters]] = {}

    def at(kind: Kind, number: int) -> float:
        if (kind, number) not in scores:
            smoothness = smoothness_of_kind(kind, float(CANDIDATES[number]))
            option = replace(hyper, drift=(smoothness, hyper.drift[1]) if axis == 0 else (hyper.drift[0], smoothness))
            believed = float(log_prior(CANDIDATES[number : number + 1], DRIFT_ORDERS[kind])[0])
            scores[kind, number] = sum(log_evidence(band, option) for band in bands) + believed, option
        return scores[kind, number][0]

    now, kinds = hyper.drift[axis], list(DRIFT_ORDERS)
    best = now.kind, int(np.argmin(np.abs(np.log(CANDIDATES / max(now.size_px, CANDIDATES[0])))))
    climbed: set[Kind] = set()
    while True:
        here = kinds.index(best[0])
        pending = [kinds[value] for value in (here, here - 1, here + 1) if 0 <= value < len(kinds) and kinds[value] not in climbed]
        if not pending:
            return scores[best][1]
        climbed.add(pending[0])
        number = best[1]
        while True:
            near = [value for value in (number - 1, number, number + 1) if 0 <= value < len(CANDIDATES)]
            likeliest = max(near, key=lambda one: at(pending[0], one))
            if likeliest == number:
                break
            number = likeliest
        best = max(scores, key=lambda one: scores[one][0])


def _strands(state: EstimatorState, pairs: tuple[int, ...], hyper: Hyperparameters, border: SharedParameters) -> tuple[TemporalSpline, ...]:
    splines = temporal_splines(state, hyper, border)
    if len(pairs) == len(state.phases):
        return splines
    frames = [when for when in state.frames if when.frame // 2 in pairs]
    begin_s = min(when.start_s - KNOT_MARGIN * when.timing.duration_s for when in frames)
    end_s = max(when.start_s + (1.0 + KNOT_MARGIN) * when.timing.duration_s for when in frames)
    some = []
    for strand in splines:
        if strand.kind == DRIFT:  # the raster has few knots, and its earlier changes determine its present value
            first = max(strand.interval(begin_s), strand.first)
            severed = bool(strand.spline.gaps_within(first, first + 1))
            strand = replace(strand, first=first, spline=strand.spline.shortened(end_s), severed=severed)
        some.append(strand)
    return tuple(some)


def _in_order(state: EstimatorState, pairs: tuple[int, ...], hyper: Hyperparameters, border: SharedParameters) -> Codes:
    codes, times = [], []
    for strand in _strands(state, pairs, hyper, border):
        knots = np.arange(strand.first, strand.spline.size)
        codes.append(strand.codes(strand.first, strand.spline.size))
        times.append(strand.spline.origin + (strand.spline.place(knots) - 0.5 * strand.spline.degree) * strand.spline.spacing)
    start = {when.frame // 2: when.start_s for when in state.frames}
    for pair in pairs:
        own, _, _ = pair_prior(state, np.zeros(state.layout.size), pair, hyper)
        codes.append(own)
        times.append(np.full(len(own), start[pair]))
    return np.concatenate(codes)[np.argsort(-np.concatenate(times), kind="stable")]
