"""What one pair says, apart from what all others say: information on its own parameters, on the border, and on both together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.accumulate import map_columns
from semlive.estimate.border import MOTION, NOISE, SHIFT, Border, Codes, Matrix, Vector, codes_of
from semlive.estimate.state import EstimatorState, MapRows


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Information of one pair's maps about a point `near`, at unit noise scale.

    Attributes:
        codes: (m,) its own parameters, sorted.
        own: (m, m) precision of these.
        to_border: (m, b) precision that they share with the border.
        pull: (m,) what the residuals ask of them.
        border_pull: (b,) and of the border.
    """

    codes: Codes
    own: Matrix
    to_border: Matrix
    pull: Vector
    border_pull: Vector


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """One component of one map: its columns on the pair's own parameters and on the border without noise."""

    place: NDArray[np.int64]
    border: Matrix
    codes: Codes
    own: Matrix
    weight: Vector
    misfit: Vector
    noise_at: slice | None


def piece(state: EstimatorState, maps: Sequence[MapRows], border: Border, near: Vector, total: Matrix, weight: float) -> Piece:
    """The information of one pair's maps; what the border gets of it times `weight` is added to `total` (b, b), in place."""
    rows = [one for dmap in maps if dmap.weight.any() for one in _components(state, dmap, border, near)]
    codes = np.unique(np.concatenate([one.codes for one in rows])) if rows else np.zeros(0, dtype=np.int64)
    own, pull = np.zeros((len(codes),) * 2), np.zeros(len(codes))
    to_border, border_pull = np.zeros((len(codes), border.size)), np.zeros(border.size)
    for one in rows:
        at = np.searchsorted(codes, one.codes)
        weighted, held = one.own * one.weight[:, None], one.border * one.weight[:, None]
        own[np.ix_(at, at)] += weighted.T @ one.own
        pull[at] += weighted.T @ one.misfit
        to_border[np.ix_(at, one.place)] += weighted.T @ one.border
        border_pull[one.place] += held.T @ one.misfit
        total[np.ix_(one.place, one.place)] += weight * (held.T @ one.border)
        if one.noise_at is not None:
            noise = np.arange(one.noise_at.start, one.noise_at.stop)
            to_border[at, one.noise_at] -= weighted.T
            border_pull[noise] -= one.weight * one.misfit
            total[noise, noise] += weight * one.weight
            # The lower triangle is read, and the noise comes last.
            total[np.ix_(noise, one.place)] -= weight * held
    return Piece(codes, own, to_border, pull, border_pull)


def first_look(state: EstimatorState, maps: Sequence[MapRows], border: Border, near: Vector) -> tuple[NDArray[np.int64], Vector]:
    """Joint indices of a pair's motion, and what it seems to be if all else is as `near` has it: enough to linearise about."""
    rows = [one for dmap in maps if dmap.weight.any() and not dmap.within_pair for one in _components(state, dmap, border, near)]
    codes = np.unique(np.concatenate([one.codes for one in rows])) if rows else np.zeros(0, dtype=np.int64)
    codes = codes[codes >> SHIFT == MOTION]
    precision, asked = np.eye(len(codes)) * 1e-6, np.zeros(len(codes))
    for one in rows:
        moving = one.codes >> SHIFT == MOTION
        at, design = np.searchsorted(codes, one.codes[moving]), one.own[:, moving]
        precision[np.ix_(at, at)] += design.T @ (design * one.weight[:, None])
        asked[at] += design.T @ (one.weight * one.misfit)
    index = state.layout.part("motion").start + (codes & ((1 << SHIFT) - 1))
    return index, near[index] + np.linalg.solve(precision, asked)


def _components(state: EstimatorState, rows: MapRows, border: Border, near: Vector) -> list[_Rows]:
    found = []
    noise, blocks = border.part(NOISE).start, state.blocks.size
    for axis, (index, design) in enumerate(map_columns(state, rows, state.about)):
        codes = codes_of(state.layout, index)
        place = border.place(codes)
        own = place < 0
        misfit = rows.disparity_px[:, axis] - design @ near[index]
        at = slice(noise + axis * blocks, noise + (axis + 1) * blocks) if rows.from_reference else None
        found.append(_Rows(place[~own], design[:, ~own], codes[own], design[:, own], rows.weight[:, axis], misfit, at))
    return found
