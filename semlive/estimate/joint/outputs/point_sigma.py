"""Standard uncertainty of a correction at every point: the systematic part of a displacement, without DIC noise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from semlive.data.disparity import DisparityMap
from semlive.estimate.joint.elimination.shared_parameters import parameter_codes
from semlive.estimate.joint.elimination.smoother import covariances
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model import Axis, FrameObservation, evaluate_drift, sighting

Field = NDArray[np.float64]
Terms = list[tuple[int, NDArray[np.int64], Field]]
"""What acts along x (0) or y (1): (points, k) indices of parameters and their factors."""
ALONG = 13  # places along the longer side of the grid; the uncertainty of a correction is smoother than the correction
TOGETHER = 32  # maps for one way back along the chain: 60 MB of their functions of the parameters


def correction_sigmas(solution: Solution, maps: Iterable[DisparityMap]) -> Iterator[tuple[Field, Field]]:
    """Standard uncertainty (ny, nx) along x and y of the correction of each map, px, without its mean over the field.

    Several maps share one backward pass of the smoother. The error is independent of the DIC noise of the frame and correlated over the
    field and from frame to frame. Its mean is not distinguishable from the motion of the specimen (F4) and is reported there as
    `shift_sigma_px`. It is computed at some positions and interpolated.

    Raises:
        IllPosed: the frame of a map is not part of the estimate.
        ValueError: a map does not start from frame 0.
    """
    queue = iter(maps)
    while together := tuple(islice(queue, TOGETHER)):
        of_pair: dict[int, list[int]] = {}
        for number, dmap in enumerate(together):
            of_pair.setdefault(dmap.current // 2, []).append(number)
        remaining = {}
        for pair, numbers in of_pair.items():
            terms = [_change(solution, together[number]) for number in numbers]
            touched = np.unique(np.concatenate([index.ravel() for term in terms for _, index, _ in term]))
            remaining[pair] = parameter_codes(solution.state.layout, touched), np.concatenate([_rows(term, touched) for term in terms])
        found: dict[int, tuple[Field, Field]] = {}
        for pair, covariance in covariances(solution.shared_posterior, remaining).items():
            for number, variance in zip(of_pair[pair], np.split(np.diag(covariance), len(of_pair[pair])), strict=True):
                found[number] = _everywhere(together[number], variance)
        yield from (found[number] for number in range(len(together)))


def _places(dmap: DisparityMap) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    step = max(1, -(-max(dmap.grid.shape) // ALONG))
    rows, columns = (np.unique(np.append(np.arange(0, count, step), count - 1)) for count in dmap.grid.shape)
    return rows, columns


def _everywhere(dmap: DisparityMap, variance: Field) -> tuple[Field, Field]:
    """Interpolate from the sampled positions to all points."""
    grid, (rows, columns) = dmap.grid, _places(dmap)
    every = np.stack(np.meshgrid(np.arange(grid.ny), np.arange(grid.nx), indexing="ij"), axis=-1)
    some = np.sqrt(np.clip(variance, 0.0, None)).reshape(2, len(rows), len(columns))
    u, v = (np.asarray(RegularGridInterpolator((rows, columns), value)(every)) for value in some)
    return u, v


def _change(solution: Solution, dmap: DisparityMap) -> Terms:
    """Terms acting at the sampled positions in the frame of the map, minus those in frame 0."""
    if dmap.reference != 0:
        raise ValueError(f"corrections are for maps from frame 0, not from frame {dmap.reference}")
    state, at = solution.state, np.ix_(*_places(dmap))
    x, y = (coordinates[at] for coordinates in dmap.grid.mesh())
    moved = [_filled(component, dmap.valid)[at] for component in (dmap.u_px, dmap.v_px)]
    here = sighting(state.frame_time(0), x, y)
    there = sighting(state.frame_time(dmap.current), x + moved[0], y + moved[1])
    return [*_acting(solution, there, 1.0), *_acting(solution, here, -1.0)]


def _filled(moved_px: Field, valid: NDArray[np.bool_]) -> Field:
    return np.where(valid, moved_px, moved_px[valid].mean() if valid.any() else 0.0)


def _acting(solution: Solution, observation: FrameObservation, sign: float) -> Terms:
    state, found = solution.state, Terms()
    observation = evaluate_drift(state.model, solution.mean, observation)
    for effect in (effect for effect in state.model if not effect.needs_ideal):
        start = state.layout.part(effect.name).start
        for columns in effect.columns(observation):
            index, value = columns.index, sign * columns.value
            for axis in (0, 1) if columns.axis is Axis.EACH else (int(columns.axis is Axis.Y),):
                found.append((axis, start + (2 * index + axis if columns.axis is Axis.EACH else index), value))
    return found


def _rows(terms: Terms, touched: NDArray[np.int64]) -> Field:
    """(2 places, m) the sum along x, then along y, as linear functions of the parameters touched; less its mean over the places."""
    total = np.zeros((2, len(terms[0][1]), len(touched)))
    for axis, index, value in terms:
        np.add.at(total[axis], (np.arange(len(index))[:, None], np.searchsorted(touched, index)), value)
    total -= total.mean(axis=1, keepdims=True)
    return total.reshape(-1, len(touched))
