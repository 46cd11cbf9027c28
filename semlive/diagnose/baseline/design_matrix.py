"""Whitened design matrix of the baseline: drift, distortion, motion and identified effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.priors import PriorCache
from semlive.diagnose.baseline.whitening import Whitener
from semlive.estimate.joint.observations.normal_equations import map_columns

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BaselineEffect:
    """An effect that is part of the baseline.

    Attributes:
        columns: (f, b, 2, q) whitened columns.
        size_px: prior standard deviation of the amplitudes, px.
    """

    columns: Array
    size_px: float


Moving = tuple[tuple[NDArray[np.int64], Array], ...]


@dataclass(frozen=True, slots=True, eq=False)
class DesignMatrix:
    """Whitened columns of the baseline; the columns of identified effects come last.

    Attributes:
        observation: the observation described by the columns.
        whiten: the whitening of the noise.
        columns: for x and for y, (f b, m) columns.
        per_frame_columns: for x and y and each frame, the columns that are not zero there, and (b, k) their mean over the frames.
        index: for x and for y, (m,) the parameters of the columns.
        parameter_indices: (p,) joint parameters of the estimator contained in the baseline.
        normal_matrix: (p + r, p + r) A^T A, with r amplitudes of effects.
        sizes_px: (r,) prior standard deviations of the amplitudes, px.
        priors: candidate priors of the parameters of the baseline.
    """

    observation: Observation
    whiten: Whitener
    columns: tuple[Array, Array]
    per_frame_columns: tuple[Moving, Moving]
    index: tuple[NDArray[np.int64], NDArray[np.int64]]
    parameter_indices: NDArray[np.int64]
    normal_matrix: Array
    sizes_px: Array
    priors: PriorCache

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.normal_matrix)

    def transposed(self, white: Array) -> Array:
        """(p + r, q) A^T times whitened fields (f, b, 2, q)."""
        total = np.zeros((self.size, white.shape[-1]))
        for axis in (0, 1):
            total[self.index[axis]] += self.along(axis, np.moveaxis(white[:, :, axis], -1, 0))
        return total

    def along(self, axis: int, rows: Array) -> Array:
        """(m, q) columns of one axis times whitened fields (q, f, b).

        Whitened fields have no mean over the frames, so the mean of the columns need not be subtracted, and most columns of the drift move
        three frames of thirty: a third of the time.
        """
        columns, own = self.columns[axis], self.per_frame_columns[axis]
        total = np.zeros((columns.shape[1], len(rows)))
        for frame, (at, block) in enumerate(own):
            total[at] += block.T @ rows[:, frame].T
        effects = columns[:, columns.shape[1] - len(self.sizes_px) :]
        total[columns.shape[1] - len(self.sizes_px) :] += effects.T @ rows.reshape(len(rows), len(columns)).T
        return total

    def apply(self, parameters: Array) -> Array:
        """(f, b, 2, q) A times parameters (p + r, q)."""
        f, b = self.observation.frames, self.observation.blocks
        parts = [(self.columns[axis] @ parameters[self.index[axis]]).reshape(f, b, 1, -1) for axis in (0, 1)]
        return np.concatenate(parts, axis=2)

    def rescaled(self, by: float) -> DesignMatrix:
        """The design matrix for noise larger by a factor."""
        columns = self.columns[0] / by, self.columns[1] / by
        own = [tuple((at, block / by) for at, block in per_frame_column) for per_frame_column in self.per_frame_columns]
        whiten = replace(self.whiten, sigma_px=self.whiten.sigma_px * by)
        return replace(self, whiten=whiten, columns=columns, per_frame_columns=(own[0], own[1]), normal_matrix=self.normal_matrix / by**2)

    def effect_columns(self, fields: Sequence[Array], effect_count: int) -> tuple[slice, ...]:
        """Ranges of the amplitudes of effects (f, b, 2, q): the first `effect_count` effects are the first, the others the last.

        Fine-scale terms for splines that are too coarse lie between.
        """
        widths = [field.shape[-1] for field in fields]
        between, ends = len(self.sizes_px) - sum(widths), np.cumsum(widths).tolist()
        starts = [
            end - width + (0 if place < effect_count else between) for place, (end, width) in enumerate(zip(ends, widths, strict=True))
        ]
        return tuple(slice(start, start + width) for start, width in zip(starts, widths, strict=True))

    def without_effects(self) -> DesignMatrix:
        """The design matrix of the baseline alone."""
        p, r = len(self.parameter_indices), len(self.sizes_px)
        columns, index = ([value[..., : value.shape[-1] - r] for value in both] for both in (self.columns, self.index))
        return replace(
            self,
            columns=(columns[0], columns[1]),
            index=(index[0], index[1]),
            normal_matrix=self.normal_matrix[:p, :p],
            sizes_px=np.zeros(0),
        )

    def with_effects(self, effect: BaselineEffect) -> DesignMatrix:
        """The design matrix with one more effect."""
        q = effect.columns.shape[-1]
        place = self.size + np.arange(q)
        flat = [np.ascontiguousarray(effect.columns[:, :, axis].reshape(-1, q)) for axis in (0, 1)]
        normal = np.zeros((self.size + q,) * 2)
        normal[: self.size, : self.size] = self.normal_matrix
        cross = self.transposed(effect.columns)
        normal[: self.size, self.size :], normal[self.size :, : self.size] = cross, cross.T
        normal[self.size :, self.size :] = sum(value.T @ value for value in flat)
        columns = [np.concatenate((column, more), axis=1) for column, more in zip(self.columns, flat, strict=True)]
        index = [np.concatenate((value, place)) for value in self.index]
        sizes = np.concatenate((self.sizes_px, np.full(q, effect.size_px)))
        return replace(self, columns=(columns[0], columns[1]), index=(index[0], index[1]), normal_matrix=normal, sizes_px=sizes)


def _per_frame(whiten: Whitener, axis: int, dense: Array) -> Moving:
    """Columns (f, b, m) that are not zero in each frame, whitened, without removal of the free reference address."""
    if whiten.over_frames is not None:
        white = whiten.unprojected(axis, dense)
        return tuple((at, value[:, at]) for value in white for at in [np.flatnonzero(value.any(axis=0))])
    nonzero_columns = [np.flatnonzero(value.any(axis=0)) for value in dense]
    return tuple((at, whiten.inverse @ value[:, at] / whiten.sigma_px) for at, value in zip(nonzero_columns, dense, strict=True))


def design(observation: Observation, whiten: Whitener) -> DesignMatrix:
    """Whitened columns of an observation, linearised about its first solution."""
    state, layout = observation.state, observation.state.layout
    dropped = np.zeros(layout.size, dtype=np.bool_)
    for change in state.raster:
        dropped[layout.part(change.name)] = True  # raster changes are effects to be identified, not part of the baseline
    retained = np.flatnonzero(~dropped)
    place = np.full(layout.size, -1)
    place[retained] = np.arange(len(retained))
    map_columns_by_frame = [map_columns(state, map_rows, state.linearisation_point) for map_rows in observation.rows]
    columns, index, moving = [], [], list[Moving]()
    for axis in (0, 1):
        used_columns = np.unique(np.concatenate([value[axis][0] for value in map_columns_by_frame]))
        used_columns = used_columns[~dropped[used_columns]]
        at = np.full(layout.size, -1)
        at[used_columns] = np.arange(len(used_columns))
        dense = np.zeros((observation.frames, observation.blocks, len(used_columns)))
        for frame, entry in enumerate(map_columns_by_frame):
            own, value = entry[axis]
            inside = at[own] >= 0
            dense[frame + 1][:, at[own[inside]]] = value[np.ix_(observation.valid_blocks, inside)]
        columns.append(whiten.one_axis(axis, dense).reshape(-1, len(used_columns)))
        index.append(place[used_columns])
        moving.append(_per_frame(whiten, axis, dense))
    normal = np.zeros((len(retained), len(retained)))
    for axis in (0, 1):
        normal[np.ix_(index[axis], index[axis])] += columns[axis].T @ columns[axis]
    columns_xy, own = (columns[0], columns[1]), (moving[0], moving[1])
    beliefs = PriorCache.of(observation, retained)
    return DesignMatrix(observation, whiten, columns_xy, own, (index[0], index[1]), retained, normal, np.zeros(0), beliefs)
