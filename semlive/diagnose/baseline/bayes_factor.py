"""Bayes factors of effects: likelihood ratio with and without an effect, refitted jointly with the baseline."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.projection import (
    ProjectedBatch,
    Projections,
    WhitenedColumns,
    effects_adjoint,
    project_batches,
    rebuilt_batches,
)
from semlive.diagnose.baseline.whitening import Whitener
from semlive.diagnose.baseline.wide_fields import WideField
from semlive.diagnose.parallel import parallel_map
from semlive.model.effects import EffectClass

Array = NDArray[np.float64]
SIZES = 6  # number of candidate sizes between the smallest and the largest expected amplitude
MAX_BYTES = 500_000_000
MIN_RELATIVE_EIGENVALUE = 1e-6  # relative to the largest: below it, the baseline absorbs the combination of columns completely


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedField:
    """A basis field projected on the data, for each point of a baseline grid.

    Attributes:
        values: (points, q) eigenvalues of the information on the amplitudes.
        vectors: (points, q, q) eigenvectors.
        gradient: (points, q) gradient along the eigenvectors.
    """

    values: Array
    vectors: Array
    gradient: Array

    @classmethod
    def of(cls, information: Array, gradient: Array) -> ProjectedField:
        """Diagonalise the information (points, q, q) and the gradient (points, q) of the amplitudes."""
        values, vectors = np.linalg.eigh(information)
        return cls(np.clip(values, 0.0, None), vectors, np.einsum("rji,rj->ri", vectors, gradient))

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self.values.shape[-1]

    def log_factor(self, sizes_px: Array) -> Array:
        """(points, sizes) log Bayes factor against no effect, for prior amplitudes of the given sizes, px."""
        return log_factor(self.values[:, None, :], self.gradient[:, None, :], sizes_px[:, None])

    def amplitudes(self, point: int, size_px: float) -> tuple[Array, Array]:
        """(q,) posterior mean and (q, q) covariance of the amplitudes."""
        variance = 1.0 / (self.values[point] + size_px**-2.0)
        vectors = self.vectors[point]
        return vectors @ (variance * self.gradient[point]), (vectors * variance) @ vectors.T


@dataclass(frozen=True, slots=True, eq=False)
class CandidateEvidence:
    """Evidence for one effect class.

    Attributes:
        family: the effect class.
        values: nonlinear parameters of each basis field.
        projected_fields: the basis fields projected on the data.
        log_bayes_factors: (basis fields, points, sizes) log Bayes factors, weighted by the likelihood of each point within the grid.
        null: (draws,) log Bayes factor of the class for bootstrap data of the most likely baseline; empty if not requested.
        refinement_gain: gain in log Bayes factor from parameter values between those of the grid; 0 if not requested.
    """

    family: EffectClass
    values: tuple[dict[str, float], ...]
    projected_fields: tuple[ProjectedField | WideField, ...]
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
        basis_field, point, size = np.unravel_index(int(np.argmax(self.log_bayes_factors)), self.log_bayes_factors.shape)
        return int(basis_field), int(point), int(size)


def log_factor(values: Array, gradient: Array, size_px: Array) -> Array:
    """(...) log Bayes factor for eigenvalues and gradients (..., q) of a basis field, amplitudes of a given prior size marginalised."""
    gain = size_px**2
    return np.asarray(0.5 * np.sum(gradient**2 * gain / (1.0 + gain * values) - np.log1p(gain * values), axis=-1))


def sizes_of(family: EffectClass) -> Array:
    """(sizes,) candidate prior amplitudes, px."""
    return np.geomspace(*family.sizes_px, SIZES)


def project(baseline: HyperparameterGrid, field: Array) -> ProjectedField:
    """Project the columns (f, b, 2, q) of one basis field, px, on the data."""
    return ProjectedField.of(*information(baseline, field))


def information(baseline: HyperparameterGrid, field: Array) -> tuple[Array, Array]:
    """For columns (f, b, 2, q), px: (points, q, q) information after marginalising the baseline, and (points, q) gradient."""
    white = WhitenedColumns.of(baseline, (field,))
    projected = _ProjectedColumns.of(baseline, white)
    return _residual_information(projected, white, 0), projected.gradient


def project_candidates(
    baseline: HyperparameterGrid, families: Sequence[EffectClass], so_far: Projections = MappingProxyType({})
) -> Projections:
    """Whiten the basis fields of each effect class, for repeated use with the same baseline and further effects.

    The result contains products alone, without the whitened fields, if these need more than half a gigabyte.

    Args:
        baseline: the baseline.
        families: effect classes to project.
        so_far: stored projections.
    """
    stored = [batch for batches in so_far.values() for batch in batches]
    sizes = [batch.nbytes if batch.columns.whitened else MAX_BYTES + 1 for batch in stored]

    def project_class(family: EffectClass) -> tuple[ProjectedBatch, ...]:
        batches = list[ProjectedBatch]()
        for batch in project_batches(baseline, family):
            sizes.append(batch.nbytes)  # of the classes in all threads
            batches.append(batch if sum(sizes) <= MAX_BYTES else batch.without_rows())
        return tuple(batches)

    projections = parallel_map(project_class, families)
    found = {**so_far, **{family.name: batches for family, batches in zip(families, projections, strict=True) if batches}}
    if sum(sizes) > MAX_BYTES:
        return {name: tuple(batch.without_rows() for batch in batches) for name, batches in found.items()}
    return found


def score_candidates(
    baseline: HyperparameterGrid, families: Sequence[EffectClass], projections: Projections | None = None
) -> tuple[CandidateEvidence, ...]:
    """Compute the evidence of effect classes; classes not observable in this run are left out.

    Args:
        baseline: the baseline, including the effects so far.
        families: effect classes to score.
        projections: result of `project_candidates` for the same baseline without the latest effects; None: not stored.
    """
    adjoint = effects_adjoint(baseline, projections or {})
    if adjoint is not None and not any(columns.size for columns in adjoint):
        adjoint = None  # without further effects the stored products are sufficient
    evidence = parallel_map(lambda family: _evidence(baseline, family, _batches(baseline, family, projections, adjoint)), families)
    return tuple(effect for effect in evidence if effect is not None)


def with_draws(
    baseline: HyperparameterGrid,
    candidates: Sequence[CandidateEvidence],
    draws: NullDraws,
    projections: Projections | None = None,
) -> tuple[CandidateEvidence, ...]:
    """Add Bayes factors of bootstrap draws of the null hypothesis to scored classes; `projections` as for `score_candidates`."""
    adjoint = effects_adjoint(baseline, projections or {})
    if adjoint is not None:
        draws = draws.with_adjoint(baseline.design.whiten)

    def null(candidate: CandidateEvidence) -> Array:
        return _null_log_factors(baseline, candidate, draws, _batches(baseline, candidate.family, projections, adjoint))

    return tuple(parallel_map(lambda candidate: replace(candidate, null=null(candidate)), candidates))


def _batches(
    baseline: HyperparameterGrid, family: EffectClass, projections: Projections | None, adjoint: tuple[Array, Array] | None
) -> Iterable[ProjectedBatch]:
    stored = (projections or {}).get(family.name)
    if not stored:
        return project_batches(baseline, family)
    return stored if adjoint is None else rebuilt_batches(baseline.design.observation.geometry, family, stored, adjoint)


def _evidence(baseline: HyperparameterGrid, family: EffectClass, batches: Iterable[ProjectedBatch]) -> CandidateEvidence | None:
    sizes, base = sizes_of(family), np.array([point.evidence for point in baseline.points]) - baseline.evidence

    def score(batch: ProjectedBatch) -> tuple[tuple[dict[str, float], ...], list[tuple[ProjectedField | WideField, Array]]]:
        return batch.values, list(_scored_fields(baseline, batch.columns, sizes))

    scored = list(map(score, batches))  # unlike a loop, `map` retains no batch while the next one is built
    if not scored:
        return None
    fields = [field for _, each in scored for field in each]
    factors = np.stack([factor for _, factor in fields]) + base[None, :, None]
    values = tuple(value for each, _ in scored for value in each)
    return CandidateEvidence(family, values, tuple(field for field, _ in fields), factors, np.zeros(0))


def field_log_factors(baseline: HyperparameterGrid, field: Array, sizes_px: Array) -> Array:
    """(points, sizes) log Bayes factors of the columns (f, b, 2, q) of a basis field, px, against no effect."""
    return next(_scored_fields(baseline, WhitenedColumns.of(baseline, (field,)), sizes_px))[1]


def _scored_fields(
    baseline: HyperparameterGrid, white: WhitenedColumns, sizes_px: Array
) -> Iterator[tuple[ProjectedField | WideField, Array]]:
    """Projections of each basis field, with (points, sizes) log Bayes factors."""
    projected = _ProjectedColumns.of(baseline, white)
    for basis_field, own in enumerate(white.spans):
        wide = WideField.of(white, basis_field)
        if wide is not None:
            each = zip(baseline.points, projected.halves, projected.gradient, strict=True)
            with suppress(np.linalg.LinAlgError):  # without noise, rounding decides
                yield (
                    wide,
                    np.concatenate(
                        [
                            wide.log_factors(half[:, own], point.factor.sides, gradient[None, own], sizes_px)
                            for point, half, gradient in each
                        ]
                    ),
                )
                continue
        found = ProjectedField.of(_residual_information(projected, white, basis_field), projected.gradient[:, own])
        yield found, found.log_factor(sizes_px)


def _null_log_factors(
    baseline: HyperparameterGrid, candidate: CandidateEvidence, draws: NullDraws, batches: Iterable[ProjectedBatch]
) -> Array:
    """(draws,) log Bayes factor of a class at the most likely point."""
    sizes, point, basis_fields = sizes_of(candidate.family), baseline.points.index(baseline.best), iter(candidate.projected_fields)

    def score(batch: ProjectedBatch) -> list[Array]:
        half = baseline.best.half(batch.columns.products_with(baseline.design))
        samples = draws.gradient(batch.columns, half)
        null = []
        for own in batch.columns.spans:
            basis_field = next(basis_fields)
            if isinstance(basis_field, WideField):
                null.append(basis_field.log_factors(half[:, own], baseline.best.factor.sides, samples[:, own], sizes))
                continue
            gains = np.outer(sizes**2, basis_field.values[point])
            fit = (samples[:, own] @ basis_field.vectors[point]) ** 2 @ (sizes[:, None] ** 2 / (1.0 + gains)).T
            null.append(0.5 * (fit - np.log1p(gains).sum(axis=1)))
        return null

    null = list(chain.from_iterable(map(score, batches)))
    return np.asarray(np.logaddexp.reduce(np.stack(null), axis=(0, 2)) - np.log(len(null) * len(sizes)))


@dataclass(frozen=True, slots=True, eq=False)
class _ProjectedColumns:
    """Whitened columns projected on the baseline.

    Attributes:
        halves: for each point, forward substitution of the products of baseline and columns.
        gradient: (points, q) gradient.
    """

    halves: tuple[Array, ...]
    gradient: Array

    @classmethod
    def of(cls, baseline: HyperparameterGrid, white: WhitenedColumns) -> _ProjectedColumns:
        """Project on all points of a baseline grid."""
        shared = white.products_with(baseline.design)
        halves = tuple(point.half(shared) for point in baseline.points)
        return cls(
            halves,
            np.stack(
                [white.residual_products - half.T @ point.half_solved_gradient for point, half in zip(baseline.points, halves, strict=True)]
            ),
        )


def _residual_information(projected: _ProjectedColumns, white: WhitenedColumns, index: int) -> Array:
    """(points, q, q) information of a basis field after marginalising the baseline."""
    own, gram = white.spans[index], white.gram_matrices[index]
    return np.stack([gram - half[:, own].T @ half[:, own] for half in projected.halves])


def residual_gram(baseline: HyperparameterGrid, field: Array) -> Array:
    """(q, q) Gram matrix of columns (f, b, 2, q), px, after marginalising the most likely baseline."""
    white = WhitenedColumns.of(baseline, (field,))
    projected = _ProjectedColumns.of(HyperparameterGrid(baseline.design, baseline.whitened_residual, (baseline.best,)), white)
    return white.gram_matrices[0] - projected.halves[0].T @ projected.halves[0]


def gradient_of(baseline: HyperparameterGrid, field: Array) -> Array:
    """(q,) gradient of the amplitudes of columns (f, b, 2, q), px, at the most likely baseline."""
    return np.asarray(
        _ProjectedColumns.of(
            HyperparameterGrid(baseline.design, baseline.whitened_residual, (baseline.best,)), WhitenedColumns.of(baseline, (field,))
        ).gradient[0]
    )


def overlap(baseline: HyperparameterGrid, field: Array, basis_field: Array) -> float:
    """Fraction of a field (f, b, 2) explained by columns (f, b, 2, q) of a basis field, after marginalising the most likely baseline."""
    gram = residual_gram(baseline, np.concatenate((field[..., None], basis_field), axis=-1))
    values, vectors = np.linalg.eigh(gram[1:, 1:])
    determined = values > MIN_RELATIVE_EIGENVALUE * values[-1]
    along = vectors[:, determined].T @ gram[1:, 0]
    return float(np.clip(np.sum(along**2 / values[determined]) / gram[0, 0], 0.0, 1.0)) if gram[0, 0] > 0.0 and determined.any() else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NullDraws:
    """Parametric bootstrap: data simulated from the most likely baseline without further effects.

    Attributes:
        noise: for x and for y, (f b, draws) whitened noise.
        half_solved_gradient: (p, draws) forward substitution of the gradient from noise and prior.
        adjoint: for x and for y, (f b, draws) adjoint of the noise, for columns in px; None if not requested.
    """

    noise: tuple[Array, Array]
    half_solved_gradient: Array
    adjoint: tuple[Array, Array] | None = None

    @classmethod
    def of(cls, baseline: HyperparameterGrid, draws: int, seed: int) -> NullDraws:
        """Draw noise and baseline parameters.

        Data ``y = A m + e`` are simulated with parameters m from the prior. After the refit of the baseline, the gradient of columns Z of a
        basis field is ``Z^T e - S^T (A^T e - L xi)``, where L L^T is the prior precision and S the posterior covariance times A^T Z. It
        does not depend on m.
        """
        rng = np.random.default_rng((seed, 41))
        f, b = baseline.design.observation.frames, baseline.design.observation.blocks
        noise = rng.normal(size=(f, b, 2, draws))
        for axis in (0, 1):
            baseline.design.whiten.without_reference(axis, noise[:, :, axis])
        prior_gradient = np.linalg.cholesky(baseline.best_prior) @ rng.normal(size=(baseline.design.size, draws))
        gradient = baseline.best.half(baseline.design.transposed(noise) - prior_gradient)
        projected = noise[:, :, 0].reshape(-1, draws), noise[:, :, 1].reshape(-1, draws)
        return cls(projected, gradient)

    def gradient(self, white: WhitenedColumns, half: Array) -> Array:
        """(draws, q) gradient of each draw for columns with the given forward-substituted coupling to the most likely baseline."""
        noise = self.noise if white.whitened else self.adjoint
        assert noise is not None  # requested by `with_adjoint` where the columns are in px
        return (white.along(noise) - half.T @ self.half_solved_gradient).T

    def with_adjoint(self, whiten: Whitener) -> NullDraws:
        """The draws with the adjoint of their noise."""
        x, y = (whiten.adjoint(axis, noise) for axis, noise in enumerate(self.noise))
        return replace(self, adjoint=(x, y))


def projected_with_draws(baseline: HyperparameterGrid, field: Array, draws: NullDraws) -> tuple[Array, Array, Array]:
    """For columns in px at the most likely point: (q,) eigenvalues, ascending, (q,) gradient of the data and (draws, q) of the null."""
    white = WhitenedColumns.of(baseline, (field,))
    projected = _ProjectedColumns.of(replace(baseline, points=(baseline.best,)), white)
    projected_field = ProjectedField.of(_residual_information(projected, white, 0), projected.gradient)
    return projected_field.values[0], projected_field.gradient[0], draws.gradient(white, projected.halves[0]) @ projected_field.vectors[0]
