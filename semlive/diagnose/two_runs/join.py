"""Runs with different scans joined with a common distortion; all other parameters are separate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid, HyperparameterPoint, evaluate_point
from semlive.diagnose.baseline.bayes_factor import ProjectedField
from semlive.diagnose.baseline.observation import sample_within_blocks
from semlive.estimate.joint.elimination.arrowhead import ComponentBlocks, factorise
from semlive.model.effects import BasisField, RunGeometry

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class JointBaseline:
    """Runs with a common distortion.

    Attributes:
        runs: baselines of the runs, with one point each.
        scenes: for each run, geometries of its frames and of frame 0 at the sample positions within blocks.
        residuals: for each run, (f, b, 2) whitened residual of its first solution with the distortion of the first run.
        place: for each run, (p_i,) indices of its parameters among the p parameters of all runs.
        point: posterior of the joint baseline.
    """

    runs: tuple[HyperparameterGrid, ...]
    scenes: tuple[tuple[tuple[RunGeometry, RunGeometry], ...], ...]
    residuals: tuple[Array, ...]
    place: tuple[NDArray[np.int64], ...]
    point: HyperparameterPoint

    def projected(self, basis_fields: Sequence[BasisField]) -> ProjectedField:
        """Project a basis field, given for each run, on the data of all runs."""
        q = basis_fields[0].field_px.shape[-1]
        alone, gradient, shared = np.zeros((q, q)), np.zeros(q), np.zeros((len(self.point.gradient), q))
        for run, residual, place, basis_field in zip(self.runs, self.residuals, self.place, basis_fields, strict=True):
            white = run.design.whiten(basis_field.field_px)
            flat = white.reshape(-1, q)
            alone, gradient = alone + flat.T @ flat, gradient + flat.T @ residual.ravel()
            shared[place] += run.design.transposed(white)
        half = self.point.half(shared)
        values, vectors = np.linalg.eigh(alone - half.T @ half)
        gradient = vectors.T @ (gradient - half.T @ self.point.half_solved_gradient)
        return ProjectedField(np.clip(values, 0.0, None)[None], vectors[None], gradient[None])


def join_runs(runs: Sequence[HyperparameterGrid]) -> JointBaseline:
    """Join runs with a common distortion; its prior is that of the run with the largest joint evidence."""
    alone = [HyperparameterGrid(run.design, run.whitened_residual, (run.best,)) for run in runs]
    return max((_joined(alone, prior_run) for prior_run in range(len(alone))), key=lambda candidate: candidate.point.evidence)


def _joined(runs: Sequence[HyperparameterGrid], prior_run: int) -> JointBaseline:
    distortion_parameters = [_distortion(run) for run in runs]
    place, size = [], len(distortion_parameters[0])
    for run, own in zip(runs, distortion_parameters, strict=True):
        at = np.full(run.design.size, -1)
        at[own] = np.arange(len(own))
        separate = np.flatnonzero(at < 0)
        at[separate] = size + np.arange(len(separate))
        place.append(at)
        size += len(separate)
    normal, prior, first_solution, gradient, power, residual = (
        np.zeros((size, size)),
        np.zeros((size, size)),
        np.zeros(size),
        np.zeros(size),
        0.0,
        [],
    )
    starts = [_first(run) for run in runs]
    for number, (run, at, own, start) in enumerate(zip(runs, place, distortion_parameters, starts, strict=True)):
        step = np.zeros(run.design.size)
        step[own] = starts[0][distortion_parameters[0]] - start[own]
        residual.append(run.whitened_residual - run.design.apply(step[:, None])[..., 0])
        normal[np.ix_(at, at)] += run.design.normal_matrix
        own_prior = run.best_prior.copy()
        if number != prior_run:
            own_prior[np.ix_(own, own)] = 0.0
        prior[np.ix_(at, at)] += own_prior
        first_solution[at] = start + step
        gradient[at] += run.design.transposed(residual[-1][..., None])[:, 0]
        power += float(np.sum(residual[-1] ** 2))
    sides = [(at, run.best.factor.sides) for run, at in zip(runs, place, strict=True)]
    each = [[at[own] for own in (*where.own, where.shared)] for at, where in sides]
    where = ComponentBlocks(*(np.unique(np.concatenate(value)) for value in zip(*each, strict=True)))
    believed = prior, factorise(prior, where, 0.0).half_log_det
    both = evaluate_point(normal, believed, gradient, power, first_solution, runs[prior_run].best.hyper, 0.0, where)
    scenes = tuple(sample_within_blocks(run.design.observation) for run in runs)
    return JointBaseline(tuple(runs), scenes, tuple(residual), tuple(place), both)


def _distortion(run: HyperparameterGrid) -> NDArray[np.int64]:
    part = run.design.observation.state.layout.part("distortion")
    return np.flatnonzero((run.design.parameter_indices >= part.start) & (run.design.parameter_indices < part.stop))


def _first(run: HyperparameterGrid) -> Array:
    mean = run.design.observation.solution.mean[run.design.parameter_indices]
    return np.concatenate((mean, np.zeros(run.design.size - len(mean))))
