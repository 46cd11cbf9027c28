"""The baseline: drift, distortion and motion of the estimator, the effects identified so far, and the residual of the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.priors import SMOOTH_DRIFT_PRIORS, DriftPrior, PriorCache
from semlive.diagnose.baseline.whitening import Whitener
from semlive.diagnose.parallel import parallel_map
from semlive.estimate.joint.elimination.arrowhead import ArrowheadFactor, ComponentBlocks, factorise
from semlive.estimate.joint.observations.normal_equations import map_columns
from semlive.estimate.joint.observations.priors import Hyperparameters
from semlive.estimate.joint.selection.marginal_likelihood import log_prior

Array = NDArray[np.float64]

FREE_DISTORTION_FACTOR = 10.0
BELIEF = 4.0  # standard deviation of the logarithm about the first choice
DISTORTION_SMOOTHNESS_FACTORS = (0.3, 1.0, 3.0)
MAX_LOG_ODDS_DEFICIT = 40.0  # log odds against a rougher drift that explains less: an effect improves it less than others


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
        beliefs: candidate priors of the parameters of the baseline.
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

        Whitened fields have no mean over the frames, so the columns' own need not be taken away, and most columns of the drift move three
        frames of thirty: a third of the time.
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
        """Where the amplitudes of effects (f, b, 2, q) are among all: the first `effect_count` came first, the others last.

        What was added since a spline of the baseline was too coarse lies between.
        """
        widths = [field.shape[-1] for field in fields]
        between, ends = len(self.sizes_px) - sum(widths), np.cumsum(widths).tolist()
        starts = [
            end - width + (0 if place < effect_count else between) for place, (end, width) in enumerate(zip(ends, widths, strict=True))
        ]
        return tuple(slice(start, start + width) for start, width in zip(starts, widths, strict=True))

    def with_effects(self, found: BaselineEffect) -> DesignMatrix:
        """The design matrix with one more effect."""
        q = found.columns.shape[-1]
        place = self.size + np.arange(q)
        flat = [np.ascontiguousarray(found.columns[:, :, axis].reshape(-1, q)) for axis in (0, 1)]
        normal = np.zeros((self.size + q,) * 2)
        normal[: self.size, : self.size] = self.normal_matrix
        cross = self.transposed(found.columns)
        normal[: self.size, self.size :], normal[self.size :, : self.size] = cross, cross.T
        normal[self.size :, self.size :] = sum(value.T @ value for value in flat)
        columns = [np.concatenate((column, more), axis=1) for column, more in zip(self.columns, flat, strict=True)]
        index = [np.concatenate((value, place)) for value in self.index]
        sizes = np.concatenate((self.sizes_px, np.full(q, found.size_px)))
        return replace(self, columns=(columns[0], columns[1]), index=(index[0], index[1]), normal_matrix=normal, sizes_px=sizes)


def design(observation: Observation, whiten: Whitener) -> DesignMatrix:
    """Whitened columns of an observation, linearised about its first solution."""
    state, layout = observation.state, observation.state.layout
    dropped = np.zeros(layout.size, dtype=np.bool_)
    for change in state.raster:
        dropped[layout.part(change.name)] = True  # raster changes are effects to be identified, not part of the baseline
    retained = np.flatnonzero(~dropped)
    place = np.full(layout.size, -1)
    place[retained] = np.arange(len(retained))
    told = [map_columns(state, map_rows, state.linearisation_point) for map_rows in observation.rows]
    columns, index, moving = [], [], list[Moving]()
    for axis in (0, 1):
        touched = np.unique(np.concatenate([value[axis][0] for value in told]))
        touched = touched[~dropped[touched]]
        at = np.full(layout.size, -1)
        at[touched] = np.arange(len(touched))
        dense = np.zeros((observation.frames, observation.blocks, len(touched)))
        for frame, entry in enumerate(told):
            own, value = entry[axis]
            inside = at[own] >= 0
            dense[frame + 1][:, at[own[inside]]] = value[np.ix_(observation.valid_blocks, inside)]
        columns.append(whiten(dense).reshape(-1, len(touched)))
        index.append(place[touched])
        there = [np.flatnonzero(value.any(axis=0)) for value in dense]
        moving.append(tuple((at, whiten.inverse @ value[:, at] / whiten.sigma_px) for at, value in zip(there, dense, strict=True)))
    normal = np.zeros((len(retained), len(retained)))
    for axis in (0, 1):
        normal[np.ix_(index[axis], index[axis])] += columns[axis].T @ columns[axis]
    both, own = (columns[0], columns[1]), (moving[0], moving[1])
    beliefs = PriorCache.of(observation, retained)
    return DesignMatrix(observation, whiten, both, own, (index[0], index[1]), retained, normal, np.zeros(0), beliefs)


@dataclass(frozen=True, slots=True, eq=False)
class HyperparameterPoint:
    """Posterior of the baseline for one smoothness.

    Attributes:
        hyper: the smoothness.
        prior: (p + r, p + r) prior precision.
        factor: factor of the posterior precision.
        evidence: log marginal likelihood, up to a constant common to all points.
        occam_factor: the Occam factor, the negative part of the evidence due to the prior volume.
        gradient: (p + r,) gradient of the log posterior at the first solution.
        half_solved_gradient: (p + r,) forward substitution of the gradient.
        prior_choice: prior of the drift, and roughness of the distortion relative to the first choice; None for joined runs.
    """

    hyper: Hyperparameters
    prior: Array
    factor: ArrowheadFactor
    evidence: float
    occam_factor: float
    gradient: Array
    half_solved_gradient: Array
    prior_choice: tuple[DriftPrior, float] | None = None

    def half(self, right: Array) -> Array:
        """(p + r, ...) forward substitution; products of two results are quadratic forms of the posterior covariance."""
        return self.factor.half(right)

    def solve(self, right: Array) -> Array:
        """(p + r, q) posterior covariance times (p + r, q)."""
        return self.factor.solve(right)


@dataclass(frozen=True, slots=True, eq=False)
class HyperparameterGrid:
    """The baseline evaluated on the data for several smoothness values.

    Attributes:
        design: the columns.
        whitened_residual: (f, b, 2) whitened residual of the first solution.
        points: one point per drift prior, the smoothest first.
    """

    design: DesignMatrix
    whitened_residual: Array
    points: tuple[HyperparameterPoint, ...]

    @property
    def best(self) -> HyperparameterPoint:
        """The most likely point."""
        return max(self.points, key=lambda candidate: candidate.evidence)

    @property
    def evidence(self) -> float:
        """Log marginal likelihood, summed over the points."""
        return float(np.logaddexp.reduce([point.evidence for point in self.points]))

    @property
    def log_evidence(self) -> float:
        """Log marginal likelihood in px instead of noise units, comparable between solutions of the same maps."""
        whiten, f = self.design.whiten, self.design.observation.frames
        volume = len(whiten.factor) * np.log(whiten.sigma_px) + np.sum(np.log(np.diag(whiten.factor)))
        return float(self.evidence - 2.0 * (f - 1) * volume)

    def residual(self) -> Array:
        """(f, b, 2) whitened residual of the most likely baseline."""
        step = self.best.solve(self.best.gradient[:, None])
        return self.whitened_residual - self.design.apply(step)[..., 0]


def build_grid(columns: DesignMatrix) -> HyperparameterGrid:
    """Evaluate, for each drift prior, the most likely smoothness of the distortion; points with negligible likelihood are left out."""
    tries = _Tries.of(columns)
    plain = parallel_map(lambda candidate: (candidate, tries.rung(candidate, 1.0)), columns.priors.different())
    best = max((rung for _, rung in plain), key=lambda candidate: candidate.evidence)
    retained = [
        (value, rung)
        for value, rung in plain
        if rung.evidence > best.evidence - MAX_LOG_ODDS_DEFICIT or rung.occam_factor > best.occam_factor
    ]
    rungs = parallel_map(lambda both: max((both[1], *tries.bent(both[0])), key=lambda candidate: candidate.evidence), retained)
    return HyperparameterGrid(columns, tries.left, tuple(rungs))


def best_point(columns: DesignMatrix) -> HyperparameterGrid:
    """Grid of one point: the most likely smoothness of the drift, then of the distortion."""
    tries = _Tries.of(columns)
    found = dict(parallel_map(lambda candidate: (candidate, tries.rung(candidate, 1.0)), columns.priors.different()))
    best = max(found, key=lambda candidate: found[candidate].evidence)
    return HyperparameterGrid(columns, tries.left, (max((found[best], *tries.bent(best)), key=lambda candidate: candidate.evidence),))


def prior_point(columns: DesignMatrix) -> HyperparameterGrid:
    """Grid of one point with the smoothness of the first solution."""
    tries = _Tries.of(columns)
    return HyperparameterGrid(columns, tries.left, (tries.rung(DriftPrior(1.0), 1.0),))


def point_like(columns: DesignMatrix, like: HyperparameterGrid) -> HyperparameterGrid:
    """Grid of one point with the most likely smoothness of another grid.

    Raises:
        ValueError: the other grid is of joined runs.
    """
    if like.best.prior_choice is None:
        raise ValueError("runs that were joined have no smoothness of one run")
    tries = _Tries.of(columns)
    return HyperparameterGrid(columns, tries.left, (tries.rung(*like.best.prior_choice),))


def with_free_distortion(columns: DesignMatrix) -> HyperparameterGrid:
    """Grid of one point: the most likely smoothness of the drift, with a distortion prior much wider than selected.

    A real distortion is not a sample of its prior. With the selected prior, one in five runs of five pairs had significant
    distortion terms.
    """
    tries = _Tries.of(columns)
    return HyperparameterGrid(
        columns,
        tries.left,
        (max((tries.rung(value, FREE_DISTORTION_FACTOR) for value in SMOOTH_DRIFT_PRIORS), key=lambda candidate: candidate.evidence),),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Tries:
    """Data common to all smoothness values."""

    columns: DesignMatrix
    near: Array
    left: Array
    pull: Array
    power: float

    @classmethod
    def of(cls, columns: DesignMatrix) -> _Tries:
        near = np.concatenate(
            (columns.observation.solution.mean[columns.parameter_indices], np.zeros(columns.size - len(columns.parameter_indices)))
        )
        residual = columns.whiten(columns.observation.disparity_px) - columns.apply(near[:, None])[..., 0]
        return cls(columns, near, residual, columns.transposed(residual[..., None])[:, 0], float(np.sum(residual**2)))

    def rung(self, drift: DriftPrior, also: float) -> HyperparameterPoint:
        columns, belief = self.columns, self.columns.priors.prior(drift, also)
        prior = _beside(belief.precision, columns.sizes_px) if columns.sizes_px.size else belief.precision
        volume, own = belief.half_log_det - float(np.sum(np.log(columns.sizes_px))), columns.priors.components
        where = replace(own, shared=np.concatenate((own.shared, np.arange(len(columns.parameter_indices), columns.size))))
        believed = log_prior(np.array([drift.bend_factor or 1.0]), (1.0, BELIEF)) + log_prior(np.array([also]), (1.0, BELIEF))
        found = evaluate_point(
            columns.normal_matrix, (prior, volume), self.pull, self.power, self.near, belief.hyper, float(believed[0]), where
        )
        return replace(found, prior_choice=(drift, also))

    def bent(self, drift: DriftPrior) -> list[HyperparameterPoint]:
        """With other smoothnesses of the distortion than the first choice."""
        return [self.rung(drift, also) for also in DISTORTION_SMOOTHNESS_FACTORS if also != 1.0]


def _beside(precision: Array, sizes_px: Array) -> Array:
    """(p + r, p + r) prior precision of the parameters of the baseline and of the amplitudes of effects."""
    p, r = len(precision), len(sizes_px)
    total = np.zeros((p + r, p + r))
    total[:p, :p] = precision
    total[range(p, p + r), range(p, p + r)] = sizes_px**-2.0
    return total


def evaluate_point(
    normal: Array,
    prior: tuple[Array, float],
    pull: Array,
    power: float,
    near: Array,
    hyper: Hyperparameters,
    believed: float,
    where: ComponentBlocks,
) -> HyperparameterPoint:
    """Evaluate a baseline of p parameters from the residual of a first solution.

    Args:
        normal: (p, p) A^T A.
        prior: (p, p) prior precision, and half its log determinant.
        pull: (p,) A^T times the whitened residual of the first solution.
        power: sum of squares of this residual.
        near: (p,) the first solution.
        hyper: the smoothness.
        believed: log prior probability of the smoothness.
        where: component blocks of the parameters.
    """
    factor = factorise(normal + prior[0], where, 0.0)
    held = prior[0] @ near
    full = pull - held
    gradient = factor.half(full)
    volume = prior[1] - factor.half_log_det
    fit = power + float(near @ held) - float(gradient @ gradient)
    return HyperparameterPoint(hyper, prior[0], factor, volume - 0.5 * fit + believed, volume, full, gradient)
