"""Information of one pair on its own parameters, on the shared parameters, and their coupling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.joint.elimination.shared_parameters import (
    LINES,
    MOTION,
    NOISE,
    SHIFT,
    STARTS,
    Codes,
    Matrix,
    SharedParameters,
    Vector,
    parameter_codes,
    parameter_indices,
)
from semlive.estimate.joint.observations.block_means import contiguous_slice
from semlive.estimate.joint.observations.design_columns import map_columns
from semlive.estimate.joint.observations.priors import GRADIENT, SHIFT_PX, Hyperparameters
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations
from semlive.model import MotionKind


@dataclass(frozen=True, slots=True, eq=False)
class PairInformation:
    """Information of the maps of one pair about a point `near`, at unit noise scale.

    Attributes:
        codes: (m,) sorted codes of its own parameters.
        precision: (m, m) precision of its own parameters.
        shared_coupling: (m, b) coupling to the border.
        gradient: (m,) gradient of its own parameters.
        shared_gradient: (b,) gradient of the border.
        shared: weighted contribution to the border; empty if not requested.
    """

    codes: Codes
    precision: Matrix
    shared_coupling: Matrix
    gradient: Vector
    shared_gradient: Vector
    shared: tuple[SharedContribution, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SharedContribution:
    """Contribution of one component of the maps of a pair to the border.

    Attributes:
        place: (k,) positions in the border.
        value: (k, k) information on them.
        noise: for each map from frame 0, positions of the noise of its blocks, information on it, and its coupling to `place`.
    """

    place: NDArray[np.int64]
    value: Matrix
    noise: tuple[tuple[slice, Vector, Matrix], ...]

    def add_to(self, total: Matrix, distortion: int) -> None:
        """Add it to `total` (b, b), whose first so many parameters are the distortion's, in place."""
        _scattered(total, self.place, distortion, self.value)
        for part, weight, coupling in self.noise:
            noise = np.arange(part.start, part.stop)
            total[noise, noise] += weight
            # The lower triangle is read, and the noise comes last.
            total[part, self.place] -= coupling


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """One component of one map: its columns on the parameters of the pair and on the border without noise, with their positions."""

    axis: int
    border: tuple[NDArray[np.int64], Matrix]
    own: tuple[Codes, Matrix]
    weight: Vector
    misfit: Vector
    noise_at: slice | None


def pair_information(
    state: EstimatorState, maps: Sequence[MapObservations], border: SharedParameters, near: Vector, weight: float | None = None
) -> PairInformation:
    """Information of the maps of one pair, and its contribution to the border times `weight`, if given."""
    rows = [component for dmap in maps if dmap.weight.any() for component in _components(state, dmap, border, near)]
    codes = np.unique(np.concatenate([map_rows.own[0] for map_rows in rows])) if rows else np.zeros(0, dtype=np.int64)
    own, pull = np.zeros((len(codes),) * 2), np.zeros(len(codes))
    to_border, border_pull = np.zeros((len(codes), border.size)), np.zeros(border.size)
    shared: list[SharedContribution] = []
    for axis in (0, 1):
        of_axis = [map_rows for map_rows in rows if map_rows.axis == axis]
        if not of_axis:
            continue
        place = np.unique(np.concatenate([shared_rows.border[0] for shared_rows in of_axis]))
        held, mine = (
            _together([shared_rows.border for shared_rows in of_axis], place),
            _together([shared_rows.own for shared_rows in of_axis], codes),
        )
        # By the weights' roots: of a matrix and its own transpose half the products are made.
        root = np.sqrt(np.concatenate([shared_rows.weight for shared_rows in of_axis]))
        misfit = root * np.concatenate([shared_rows.misfit for shared_rows in of_axis])
        mine *= root[:, None]
        held *= root[:, None]
        own += mine.T @ mine
        pull += mine.T @ misfit
        to_border[:, place] += mine.T @ held
        border_pull[place] += held.T @ misfit
        noise: list[tuple[slice, Vector, Matrix]] = []
        for number, shared_rows in enumerate(of_axis):
            if shared_rows.noise_at is None:
                continue
            here = slice(number * state.blocks.size, (number + 1) * state.blocks.size)
            to_border[:, shared_rows.noise_at] -= (mine[here] * root[here, None]).T
            border_pull[shared_rows.noise_at] -= shared_rows.weight * shared_rows.misfit
            if weight is not None:
                noise.append((shared_rows.noise_at, weight * shared_rows.weight, weight * held[here] * root[here, None]))
        if weight is not None:
            shared.append(SharedContribution(place, weight * (held.T @ held), tuple(noise)))
    return PairInformation(codes, own, to_border, pull, border_pull, tuple(shared))


def shared_information(state: EstimatorState, border: SharedParameters, weight: float) -> Matrix:
    """(b, b) what the border gets from all pairs of a state that holds its sums, times `weight`; the lower triangle counts."""
    total, count = np.zeros((border.size,) * 2), border.joint_size
    index, noise, blocks = parameter_indices(state.layout, border.codes()[:count]), border.part(NOISE), state.blocks.size
    total[:count, :count] = state.precision[np.ix_(index, index)]
    for axis in (0, 1):
        total[noise.start + axis * blocks : noise.start + (axis + 1) * blocks, :count] = state.reference.coupling[axis][:, index]
    diagonal = np.arange(noise.start, noise.stop)
    total[diagonal, diagonal] = (state.reference.weight - state.reference.prior).T.ravel()
    return total * weight


def _together(parts: Sequence[tuple[NDArray[np.int64], Matrix]], place: NDArray[np.int64]) -> Matrix:
    """Columns of several maps, each with its own positions, stacked over the positions `place`."""
    total = np.zeros((sum(len(value) for _, value in parts), len(place)))
    row = 0
    for at, value in parts:
        total[row : row + len(value), contiguous_slice(np.searchsorted(place, at))] = value
        row += len(value)
    return total


def _scattered(total: Matrix, place: NDArray[np.int64], distortion: int, value: Matrix) -> None:
    """Add `value` at sorted positions `place`, in place.

    Distortion parameters of one component (every second) are added in one operation.
    """
    count = int(np.searchsorted(place, distortion))
    if 2 * count == distortion:
        every = slice(int(place[0]), distortion, 2)
        total[every, every] += value[:count, :count]
        others = place[count:]
        total[every, others] += value[:count, count:]
        total[others, every] += value[count:, :count]
        total[np.ix_(others, others)] += value[count:, count:]
    else:
        total[np.ix_(place, place)] += value


def initial_motion(
    state: EstimatorState, maps: Sequence[MapObservations], border: SharedParameters, near: Vector
) -> tuple[NDArray[np.int64], Vector]:
    """Joint indices and initial estimate of the motion of a pair, all other parameters fixed at `near`, for linearisation."""
    rows = [
        component for dmap in maps if dmap.weight.any() and not dmap.within_pair for component in _components(state, dmap, border, near)
    ]
    codes = np.unique(np.concatenate([map_rows.own[0] for map_rows in rows])) if rows else np.zeros(0, dtype=np.int64)
    codes = codes[codes >> SHIFT == MOTION]
    precision, gradient = np.eye(len(codes)) * 1e-6, np.zeros(len(codes))
    for shared_rows in rows:
        own_codes, value = shared_rows.own
        moving = own_codes >> SHIFT == MOTION
        at, design = np.searchsorted(codes, own_codes[moving]), value[:, moving]
        precision[np.ix_(at, at)] += design.T @ (design * shared_rows.weight[:, None])
        gradient[at] += design.T @ (shared_rows.weight * shared_rows.misfit)
    index = state.layout.part("motion").start + (codes & ((1 << SHIFT) - 1))
    return index, near[index] + np.linalg.solve(precision, gradient)


def _components(state: EstimatorState, rows: MapObservations, border: SharedParameters, near: Vector) -> list[_Rows]:
    found = []
    noise, blocks, layout = border.part(NOISE).start, state.blocks.size, state.layout
    for axis, (index, design) in enumerate(map_columns(state, rows, state.linearisation_point)):
        codes = parameter_codes(layout, index)
        place = border.place(codes)
        own = place < 0
        misfit = rows.disparity_px[:, axis] - design @ near[index]
        at = slice(noise + axis * blocks, noise + (axis + 1) * blocks) if rows.from_reference else None
        found.append(_Rows(axis, (place[~own], design[:, ~own]), (codes[own], design[:, own]), rows.weight[:, axis], misfit, at))
    return found


def pair_prior(state: EstimatorState, near: Vector, pair: int | None, hyper: Hyperparameters) -> tuple[Codes, Vector, Vector]:
    """Codes of a pair's motion, start error and row shifts, sorted; the prior precision of each, and its gradient at `near`."""
    if pair is None:
        nothing = np.zeros(0)
        return np.zeros(0, dtype=np.int64), nothing, nothing
    codes, believed = np.zeros(0, dtype=np.int64), np.zeros(0)
    for part in (state.row_shifts.part(frame) for frame in (2 * pair, 2 * pair + 1) if frame):
        codes = np.concatenate((codes, (LINES << SHIFT) | np.arange(part.start, part.stop, dtype=np.int64)))
        believed = np.concatenate((believed, np.full(part.stop - part.start, (hyper.row_shift_px or 1.0) ** -2.0)))
    late = state.start_time_errors.part(pair)
    codes = np.concatenate((codes, (STARTS << SHIFT) | np.arange(late.start, late.stop, dtype=np.int64)))
    believed = np.concatenate((believed, np.array(state.start_time_errors.sigma_s[late]) ** -2.0))
    if pair in state.motions.pairs:
        part, kind = state.motions.part(pair)
        shift, gradient = SHIFT_PX**-2.0, GRADIENT**-2.0
        codes = np.concatenate((codes, (MOTION << SHIFT) | np.arange(part.start, part.stop, dtype=np.int64)))
        of_motion = (shift, shift, hyper.rotation_rad**-2.0) if kind is MotionKind.RIGID else (shift, gradient, gradient) * 2
        believed = np.concatenate((believed, of_motion))
    return codes, believed, believed * near[parameter_indices(state.layout, codes)]
