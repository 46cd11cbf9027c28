"""Bayes factors of effects: likelihood ratio with and without an effect, refitted jointly with the baseline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.projection import CandidateProjection, WhitenedColumns, project_candidate
from semlive.diagnose.parallel import WORKERS, parallel_map
from semlive.model.effects import EffectClass

Array = NDArray[np.float64]
SIZES = 6  # number of candidate sizes between the smallest and the largest expected amplitude
MAX_BYTES = 500_000_000
MIN_RELATIVE_EIGENVALUE = 1e-6  # of the largest eigenvalue: sums of a law's columns that the baseline takes whole say nothing


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedField:
    """A basis field projected on the data, for each point of a grid.

    Attributes:
        values: (rungs, q) eigenvalues of the information on the amplitudes.
        vectors: (rungs, q, q) eigenvectors.
        gradient: (rungs, q) gradient along the eigenvectors.
    """

    values: Array
    vectors: Array
    gradient: Array

    @classmethod
    def of(cls, information: Array, pull: Array) -> ProjectedField:
        """Diagonalise the information (rungs, q, q) and the gradient (rungs, q) of the amplitudes."""
        values, vectors = np.linalg.eigh(information)
        return cls(np.clip(values, 0.0, None), vectors, np.einsum("rji,rj->ri", vectors, pull))

    def log_factor(self, sizes_px: Array) -> Array:
        """(rungs, sizes) log Bayes factor against no effect, for prior amplitudes of the given sizes, px."""
        return log_factor(self.values[:, None, :], self.gradient[:, None, :], sizes_px[:, None])

    def amplitudes(self, rung: int, size_px: float) -> tuple[Array, Array]:
        """(q,) posterior mean and (q, q) covariance of the amplitudes."""
        more = 1.0 / (self.values[rung] + size_px**-2.0)
        vectors = self.vectors[rung]
        return vectors @ (more * self.gradient[rung]), (vectors * more) @ vectors.T


@dataclass(frozen=True, slots=True, eq=False)
class CandidateEvidence:
    """Evidence for one effect class.

    Attributes:
        family: the effect class.
        values: nonlinear parameters of each basis field.
        projected_fields: the basis fields projected on the data.
        log_bayes_factors: (laws, rungs, sizes) log Bayes factors, weighted by the likelihood of each point within the grid.
        null: (draws,) log Bayes factor of the class for bootstrap data of the most likely baseline; empty if not requested.
        refinement_gain: gain in log Bayes factor from parameter values between those of the grid; 0 if not requested.
    """

    family: EffectClass
    values: tuple[dict[str, float], ...]
    projected_fields: tuple[ProjectedField, ...]
    log_bayes_factors: Array
    null: Array
    refinement_gain: float = 0.0

    @property
    def log_factor(self) -> float:
        """Log Bayes factor of the class: mean over basis fields and sizes, with each smoothness weighted by its likelihood."""
        return (
            float(
                np.logaddexp.reduce(self.log_bayes_factors, axis=None)
                - np.log(self.log_bayes_factors.shape[0] * self.log_bayes_factors.shape[2])
            )
            + self.refinement_gain
        )

    @property
    def best(self) -> tuple[int, int, int]:
        """Indices of the most likely basis field, point and size."""
        basis_field, rung, size = np.unravel_index(int(np.argmax(self.log_bayes_factors)), self.log_bayes_factors.shape)
        return int(basis_field), int(rung), int(size)


def log_factor(values: Array, pull: Array, size_px: Array) -> Array:
    """(...) log Bayes factor for eigenvalues and gradients (..., q) of a basis field, amplitudes of a given prior size marginalised."""
    gain = size_px**2
    return np.asarray(0.5 * np.sum(pull**2 * gain / (1.0 + gain * values) - np.log1p(gain * values), axis=-1))


def sizes_of(family: EffectClass) -> Array:
    """(sizes,) candidate prior amplitudes, px."""
    return np.geomspace(*family.sizes_px, SIZES)


def project(baseline: HyperparameterGrid, field: Array) -> ProjectedField:
    """Project the columns (f, b, 2, q) of one basis field, px, on the data."""
    return ProjectedField.of(*information(baseline, field))


def information(baseline: HyperparameterGrid, field: Array) -> tuple[Array, Array]:
    """For columns (f, b, 2, q), px: (rungs, q, q) information after marginalising the baseline, and (rungs, q) gradient."""
    white = WhitenedColumns.of(baseline, (field,))
    flat = _Flat.of(baseline, white)
    return _left_of(flat, white, 0), flat.pull


def project_candidates(
    ladder: HyperparameterGrid, families: Sequence[EffectClass], so_far: Mapping[str, CandidateProjection] = MappingProxyType({})
) -> dict[str, CandidateProjection]:
    """Whiten the basis fields of each effect class, for repeated use with the same baseline and further effects.

    Returns an empty mapping if the projections need more than half a gigabyte.

    Args:
        ladder: the baseline.
        families: effect classes to project.
        so_far: projections already stored.
    """
    scene, found = ladder.design.observation.geometry, dict(so_far)
    for first in range(0, len(families), WORKERS):
        some = families[first : first + WORKERS]
        projections = parallel_map(lambda family: project_candidate(ladder, family, scene), some)
        found |= {family.name: value for family, value in zip(some, projections, strict=True) if value is not None}
        if sum(projection.nbytes for projection in found.values()) > MAX_BYTES:
            return {}
    return found


def score_candidates(
    ladder: HyperparameterGrid, families: Sequence[EffectClass], projections: Mapping[str, CandidateProjection] | None = None
) -> tuple[CandidateEvidence, ...]:
    """Compute the evidence of effect classes; classes not observable in this run are left out.

    Args:
        ladder: the baseline, including the effects so far.
        families: effect classes to score.
        projections: result of `project_candidates` for the same baseline without the latest effects; None: not stored.
    """
    found = parallel_map(lambda family: _weighed(ladder, family, _asked(ladder, family, projections)), families)
    return tuple(effect for effect in found if effect is not None)


def with_draws(
    ladder: HyperparameterGrid,
    candidates: Sequence[CandidateEvidence],
    draws: NullDraws,
    projections: Mapping[str, CandidateProjection] | None = None,
) -> tuple[CandidateEvidence, ...]:
    """Add Bayes factors of bootstrap draws of the null hypothesis to scored classes; `projections` as for `score_candidates`."""
    return tuple(parallel_map(lambda candidate: replace(candidate, null=_drawn(ladder, candidate, draws, projections)), candidates))


def _asked(
    ladder: HyperparameterGrid, family: EffectClass, projections: Mapping[str, CandidateProjection] | None
) -> CandidateProjection | None:
    return (projections or {}).get(family.name) or project_candidate(ladder, family, ladder.design.observation.geometry)


def _weighed(ladder: HyperparameterGrid, family: EffectClass, projection: CandidateProjection | None) -> CandidateEvidence | None:
    if projection is None:
        return None
    sizes, base = sizes_of(family), np.array([point.evidence for point in ladder.points]) - ladder.evidence
    basis_fields = [basis_field for batch in projection.batches for basis_field in _against(_Flat.of(ladder, batch), batch)]
    factors = np.stack([basis_field.log_factor(sizes) for basis_field in basis_fields]) + base[None, :, None]
    return CandidateEvidence(family, projection.values, tuple(basis_fields), factors, np.zeros(0))


def _drawn(
    ladder: HyperparameterGrid, candidate: CandidateEvidence, draws: NullDraws, projections: Mapping[str, CandidateProjection] | None
) -> Array:
    """(draws,) log Bayes factor of a class at the most likely point."""
    gradient, sizes, rung, basis_fields = (
        _asked(ladder, candidate.family, projections),
        sizes_of(candidate.family),
        ladder.points.index(ladder.best),
        iter(candidate.projected_fields),
    )
    assert gradient is not None  # it was weighed
    null = []
    for batch in gradient.batches:
        samples = draws.pull(batch, ladder.best.half(batch.products_with(ladder.design)))
        for own in batch.spans:
            basis_field = next(basis_fields)
            gains = np.outer(sizes**2, basis_field.values[rung])
            fit = (samples[:, own] @ basis_field.vectors[rung]) ** 2 @ (sizes[:, None] ** 2 / (1.0 + gains)).T
            null.append(0.5 * (fit - np.log1p(gains).sum(axis=1)))
    return np.asarray(np.logaddexp.reduce(np.stack(null), axis=(0, 2)) - np.log(len(null) * len(sizes)))


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    """Whitened columns projected on the baseline.

    Attributes:
        halves: for each point, forward substitution of the products of baseline and columns.
        pull: (rungs, q) gradient.
    """

    halves: tuple[Array, ...]
    pull: Array

    @classmethod
    def of(cls, ladder: HyperparameterGrid, white: WhitenedColumns) -> _Flat:
        """For all rungs of a ladder."""
        shared = white.products_with(ladder.design)
        halves = tuple(rung.half(shared) for rung in ladder.points)
        return cls(
            halves,
            np.stack(
                [white.residual_products - half.T @ rung.half_solved_gradient for rung, half in zip(ladder.points, halves, strict=True)]
            ),
        )


def _against(flat: _Flat, white: WhitenedColumns) -> tuple[ProjectedField, ...]:
    """Projections of each basis field."""
    return tuple(ProjectedField.of(_left_of(flat, white, basis_field), flat.pull[:, own]) for basis_field, own in enumerate(white.spans))


def _left_of(flat: _Flat, white: WhitenedColumns, index: int) -> Array:
    """(rungs, q, q) information of a basis field after marginalising the baseline."""
    own, alone = white.spans[index], white.gram_matrices[index]
    return np.stack([alone - halve[:, own].T @ halve[:, own] for halve in flat.halves])


def residual_gram(ladder: HyperparameterGrid, field: Array) -> Array:
    """(q, q) Gram matrix of columns (f, b, 2, q), px, after marginalising the most likely baseline."""
    white = WhitenedColumns.of(ladder, (field,))
    flat = _Flat.of(HyperparameterGrid(ladder.design, ladder.whitened_residual, (ladder.best,)), white)
    return white.gram_matrices[0] - flat.halves[0].T @ flat.halves[0]


def gradient_of(ladder: HyperparameterGrid, field: Array) -> Array:
    """(q,) gradient of the amplitudes of columns (f, b, 2, q), px, at the most likely baseline."""
    return np.asarray(
        _Flat.of(HyperparameterGrid(ladder.design, ladder.whitened_residual, (ladder.best,)), WhitenedColumns.of(ladder, (field,))).pull[0]
    )


def overlap(ladder: HyperparameterGrid, field: Array, basis_field: Array) -> float:
    """Fraction of a field (f, b, 2) explained by columns (f, b, 2, q) of a basis field, after marginalising the most likely baseline."""
    both = residual_gram(ladder, np.concatenate((field[..., None], basis_field), axis=-1))
    values, vectors = np.linalg.eigh(both[1:, 1:])
    determined = values > MIN_RELATIVE_EIGENVALUE * values[-1]
    along = vectors[:, determined].T @ both[1:, 0]
    return float(np.clip(np.sum(along**2 / values[determined]) / both[0, 0], 0.0, 1.0)) if both[0, 0] > 0.0 and determined.any() else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NullDraws:
    """Parametric bootstrap: data simulated from the most likely baseline without further effects.

    Attributes:
        noise: for x and for y, (f b, draws) whitened noise.
        half_solved_gradient: (p, draws) forward substitution of the gradient from noise and prior.
    """

    noise: tuple[Array, Array]
    half_solved_gradient: Array

    @classmethod
    def of(cls, ladder: HyperparameterGrid, draws: int, seed: int) -> NullDraws:
        """So many draws.

        With parameters m drawn as they are believed, ``y = A m + e``, the baseline's refit leaves ``Z^T e - S^T (A^T e - L xi)`` of a
        law's columns Z, L L^T being the prior's precision and S the posterior covariance times A^T Z: nothing of m itself.
        """
        rng = np.random.default_rng((seed, 41))
        f, b = ladder.design.observation.frames, ladder.design.observation.blocks
        noise = rng.normal(size=(f, b, 2, draws))
        noise -= noise.mean(axis=0)
        believed = np.linalg.cholesky(ladder.best.prior) @ rng.normal(size=(ladder.design.size, draws))
        gradient = ladder.best.half(ladder.design.transposed(noise) - believed)
        flat = noise[:, :, 0].reshape(-1, draws), noise[:, :, 1].reshape(-1, draws)
        return cls(flat, gradient)

    def pull(self, white: WhitenedColumns, half: Array) -> Array:
        """(draws, q) gradient of each draw for columns with the given forward-substituted coupling to the most likely baseline."""
        return (white.along(self.noise) - half.T @ self.half_solved_gradient).T


def projected_with_draws(ladder: HyperparameterGrid, field: Array, draws: NullDraws) -> tuple[Array, Array, Array]:
    """For columns in px at the most likely point: (q,) eigenvalues, ascending, (q,) gradient of the data and (draws, q) of the null."""
    white = WhitenedColumns.of(ladder, (field,))
    flat = _Flat.of(replace(ladder, points=(ladder.best,)), white)
    (all_of_it,) = _against(flat, white)
    return all_of_it.values[0], all_of_it.gradient[0], draws.pull(white, flat.halves[0]) @ all_of_it.vectors[0]
