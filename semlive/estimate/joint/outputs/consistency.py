"""Consistency checks: halves of the data are solved separately and their difference is compared with its covariance.

Both halves use the smoothness, weights and linearisation of the full data. ``S = (P + L)^-1`` is the covariance of a half (P its
information, L the common prior). The difference has the covariance ``S_a + S_b - S_a (L + X) S_b - transposed``: the common
prior cannot cause a
difference, and X is the common noise, that of frame 0 where both halves contain the same points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammaincc, ndtri

from semlive.data.notes import Note, NoteCode, information, warning
from semlive.estimate.joint.observations.accumulation import dense_limit
from semlive.estimate.joint.observations.normal_equations import NormalMatrix, add_prior, add_rows, marginal, with_normal_matrix
from semlive.estimate.joint.observations.priors import gauge_precision, prior_precision
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations, ReferenceNoise
from semlive.estimate.joint.outputs.split_consistency import field_half_difference, odd_even_difference
from semlive.estimate.joint.selection.marginal_likelihood import regularise
from semlive.estimate.joint.solution.posterior import Solution
from semlive.estimate.joint.solution.solver import previous_selection
from semlive.estimate.joint.solution.subset import sampled_pair_numbers

Field = NDArray[np.float64]
WARN_SIGMAS = 4.0
MIN_PAIRS = 4  # with fewer, a half has one translated pair, which does not determine the distortion
LATTICE = 9  # points along x and y where distortions are compared


@dataclass(frozen=True, slots=True)
class HalfSplitCheck:
    """Difference between two halves of the data.

    Attributes:
        name: ``split field`` (left and right half of the points: drift within frames) or ``odd and even pairs`` (distortion).
        difference_px: root mean square of the difference, px.
        expected_px: expected root mean square from noise alone, px.
        sigmas: improbability of the difference as standard deviations of a normal distribution; negative if smaller than expected.
    """

    name: str
    difference_px: float
    expected_px: float
    sigmas: float

    def note(self) -> Note:
        """The result for the operator; a warning if the difference exceeds the limit."""
        text = f"{self.name} differ by {self.difference_px:.2g} px rms where noise gives {self.expected_px:.2g} px"
        if self.sigmas <= WARN_SIGMAS:
            return information(_CODE[self.name], f"consistency: {text}")
        return warning(_CODE[self.name], f"{text} ({self.sigmas:.0f} sigma): {_REASON[self.name]}")


FIELD, PAIRS = "drifts from the left and right half of the field", "distortions from odd and even pairs"
_CODE = {FIELD: NoteCode.FIELD_HALVES, PAIRS: NoteCode.PAIR_HALVES}
_REASON = {
    FIELD: "part of the field moved on its own or was badly correlated; look at the maps' quality before trusting sigmas",
    PAIRS: "the distortion changed during the run, or a pair is wrong; look for a change of the microscope's settings",
}


def consistency(solution: Solution) -> tuple[HalfSplitCheck, ...]:
    """Check the drift by a split field and the distortion by odd and even pairs; empty if a half has too little data.

    The cost is two passes over half of the block means and four factorisations. The weights of each half are derived from those of the full
    data. With more than `dense_limit` pairs, the checks use a sample of the pairs since the last selection, so the cost is bounded and
    each part of a long run is checked.
    """
    count = len(solution.state.phases)
    if count < MIN_PAIRS:
        return ()
    if count > dense_limit(solution.state):
        pairs, shape = sampled_pair_numbers(solution.state, previous_selection(count)), _shape_of_distortion(solution.state)
        return _half_split_check(FIELD, *field_half_difference(solution, pairs)), _half_split_check(
            PAIRS, *odd_even_difference(solution, pairs, shape)
        )
    solution = replace(solution, state=with_normal_matrix(solution.state))
    state = solution.state
    first_half = (np.arange(state.blocks.size) % state.blocks.layout[1]) < state.blocks.layout[1] // 2
    every = np.ones(state.blocks.size, dtype=np.bool_)
    return (
        _agreement(solution, FIELD, lambda rows: first_half, _within_frames(state)),
        _agreement(solution, PAIRS, lambda rows: every & (rows.current // 2 % 2 == 1), _of_all(state, _shape_of_distortion(state))),
    )


BlockSelector = Callable[[MapObservations], NDArray[np.bool_]]


def _agreement(solution: Solution, name: str, choose: BlockSelector, rows: Field) -> HalfSplitCheck:
    """Compare linear functions (k, n) of the parameters between the chosen blocks and the other blocks."""
    state, weight = solution.state, solution.hyper.noise_scale**-2.0
    belief = prior_precision(state, solution.hyper) + gauge_precision(state)
    half_fit = _half(state, choose)
    values, spreads = [], []
    for half in (half_fit, _rest(state, half_fit)):
        precision, information = marginal(half)
        factor = cho_factor(regularise(precision * weight + belief), lower=True, check_finite=False)
        spread = cho_solve(factor, rows.T, check_finite=False)
        values.append(spread.T @ ((information - precision @ solution.mean) * weight - belief @ solution.mean))
        spreads.append((half.reference, spread))
    difference = values[0] - values[1]
    (noise, spread), (other_noise, second_spread) = spreads
    cross = spread.T @ belief @ second_spread + _shared(noise, spread, other_noise, second_spread) * weight
    return _half_split_check(name, difference, rows @ (spread + second_spread) - cross - cross.T)


def _half_split_check(name: str, difference: Field, covariance: Field) -> HalfSplitCheck:
    expected_px, measured_px = (
        float(np.sqrt(max(value, 0.0) / len(difference))) for value in (np.trace(covariance), difference @ difference)
    )
    return HalfSplitCheck(name, measured_px, expected_px, _sigmas(difference, covariance))


def _sigmas(difference: Field, covariance: Field) -> float:
    """Improbability of a difference as standard deviations.

    Directions are weighted by their noise, so that a poorly determined direction does not hide the others. Beyond the median,
    better determined
    directions get less weight, because there an error of a few per cent in sigma would cause a false alarm.
    """
    values, vectors = np.linalg.eigh(covariance)
    values = np.clip(values, 0.0, None)
    weight = 1.0 / (values + max(float(np.median(values[values > 1e-9 * values[-1]])), 1e-24))
    counted = weight * values
    # A weighted sum of squares is about a chi square with this freedom (Satterthwaite).
    freedom = max(float(counted.sum() ** 2 / np.sum(counted**2)), 1.0)
    ratio = float(weight @ (difference @ vectors) ** 2 / counted.sum())
    return float(-ndtri(np.clip(gammaincc(0.5 * freedom, 0.5 * ratio * freedom), 1e-300, 1.0 - 1e-16)))


def _half(state: EstimatorState, choose: BlockSelector) -> EstimatorState:
    """State with the information of the chosen blocks only."""
    n = len(state.information)
    sums = NormalMatrix(np.zeros((n, n)), np.zeros(n), ReferenceNoise.empty(state.blocks.size, n))
    for map_rows in state.rows:
        masked = replace(map_rows, weight=np.where(choose(map_rows)[:, None], map_rows.weight, 0.0))
        if masked.weight.any():
            add_rows(state, masked, state.linearisation_point, sums)
            add_prior(masked, sums.reference)
    return replace(state, precision=sums.precision, information=sums.information, reference=sums.reference)


def _rest(state: EstimatorState, half: EstimatorState) -> EstimatorState:
    """Information of the full data minus that of a half."""
    full, part = state.reference, half.reference
    weight = (full.weight - full.prior) - (part.weight - part.prior)
    common = weight > 1e-9 * full.weight
    reference = replace(
        full,
        weight=np.where(common, weight + full.prior, 0.0),
        prior=np.where(common, full.prior, 0.0),
        coupling=full.coupling - part.coupling,
        information=np.where(common, full.information - part.information, 0.0),
    )
    return replace(state, precision=state.precision - half.precision, information=state.information - half.information, reference=reference)


def _shared(first: ReferenceNoise, spread: Field, second: ReferenceNoise, second_spread: Field) -> Field:
    """(k, k) contribution of the noise of frame 0, in blocks of both halves, to the covariance of their functions."""
    total = np.zeros((spread.shape[1],) * 2)
    for axis in (0, 1):
        weight = [np.where(half.weight[:, axis] > 0, half.weight[:, axis], np.inf) for half in (first, second)]
        common = np.sqrt(first.prior[:, axis] * second.prior[:, axis]) / weight[0] / weight[1]
        total += (first.coupling[axis] @ spread).T @ (common[:, None] * (second.coupling[axis] @ second_spread))
    return total


def _within_frames(state: EstimatorState) -> Field:
    """(4 frames, n) change of the drift along x and y from the middle of each frame to its ends. It contains no shift."""
    drift, part = state.drift, state.layout.part("drift")
    assert drift is not None  # a solution has data
    begin, middle, end = (
        drift.rows([when.start_s + fraction * when.timing.duration_s for when in state.frames]) for fraction in (0.0, 0.5, 1.0)
    )
    change = np.concatenate((begin - middle, end - middle))
    rows = np.zeros((2 * len(change), state.layout.size))
    for axis in (0, 1):
        rows[axis * len(change) : (axis + 1) * len(change), part.start + axis : part.stop : 2] = change
    return rows


def _shape_of_distortion(state: EstimatorState) -> Field:
    """(2 m, d) distortion on a coarse lattice over the grid, less its best affine map, as functions of its own parameters."""
    grid, spline = state.grid, state.distortion
    x, y = (
        coordinates.ravel() for coordinates in np.meshgrid(*(np.linspace(axis[0], axis[-1], LATTICE) for axis in (grid.x_px, grid.y_px)))
    )
    # The field is linear in its parameters: one column for each of one component's.
    (index_x, value_x), (index_y, value_y) = spline.along_x.local(x), spline.along_y.local(y)
    own = np.zeros((len(x), spline.along_y.size, spline.along_x.size))
    at = np.arange(len(x))[:, None, None]
    own[at, index_y[:, :, None], index_x[:, None, :]] = value_y[:, :, None] * value_x[:, None, :]
    plane = np.column_stack((np.ones(len(x)), x - x.mean(), y - y.mean()))
    shape = own.reshape(len(x), -1)
    shape = shape - plane @ np.linalg.lstsq(plane, shape, rcond=None)[0]
    rows = np.zeros((2 * len(x), spline.size))
    for axis in (0, 1):
        rows[axis * len(x) : (axis + 1) * len(x), axis::2] = shape
    return rows


def _of_all(state: EstimatorState, rows: Field) -> Field:
    """Functions of the distortion's parameters as functions of all."""
    total = np.zeros((len(rows), state.layout.size))
    total[:, state.layout.part("distortion")] = rows
    return total
