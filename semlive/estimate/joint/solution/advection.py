"""Selections of a long run that the first pairs determined: distortion advection and typical specimen rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semlive.data.drift import TermTest
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.elimination.shared_parameters import NOISE, Matrix, Vector
from semlive.estimate.joint.elimination.smoother import mean_of, solve_shared
from semlive.estimate.joint.observations.design_columns import predicted
from semlive.estimate.joint.observations.priors import Hyperparameters, rotation_indices
from semlive.estimate.joint.observations.reformulate import with_advected_distortion, with_static_distortion
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.estimate.joint.selection.model_selection import COUPLING_SIGMAS, advection_column
from semlive.estimate.joint.solution.posterior import Solution
from semlive.estimate.joint.solution.subset import sampled_pair_numbers, subset_state

LEAST_RAD = 1e-7


def reestimate_advection(solution: Solution, since: int) -> TermTest:
    """Estimate the advection coefficient gamma again from the pairs after the first `since`.

    The estimate uses one extra column, as in `distortion_advection`, and a chain of 32 pairs. All other parameters are fitted to
    the column;
    only the residual of that fit determines gamma. If gamma differs from the selected value, the pairs are fitted with and
    without advection
    and the fit with the smaller residual is selected.
    """
    state, near = subset_state(solution, sampled_pair_numbers(solution.state, since))
    noise_px, carried = (
        solution.shared_posterior.step[solution.shared_posterior.chain.border.part(NOISE)],
        solution.state.distortion.carried,
    )
    used_rows = [rows for rows in state.rows if rows.weight.any() and rows.disparity_px.any()]
    columns = [advection_column(solution.state, rows, solution.mean) for rows in used_rows]
    as_data = tuple(replace(rows, disparity_px=column) for rows, column in zip(used_rows, columns, strict=True))
    fit = solve_shared(eliminate_all(replace(state, rows=as_data), solution.hyper, np.zeros(len(near))))
    unexplained = _map_residuals(replace(state, rows=as_data), mean_of(fit), fit.step[fit.chain.border.part(NOISE)])
    misfit = _map_residuals(replace(state, rows=tuple(used_rows)), near, noise_px)
    own = sum(
        float(np.sum(rows.weight * residual * column)) for rows, residual, column in zip(used_rows, unexplained, columns, strict=True)
    )
    pulled = sum(
        float(np.sum(rows.weight * residual * change)) for rows, residual, change in zip(used_rows, unexplained, misfit, strict=True)
    )
    gamma = float(carried) + (pulled / own if own > 0 else 0.0)  # with advection in the model, the residual determines a change of gamma
    sigma = float(solution.hyper.noise_scale / np.sqrt(own)) if own > 0 else np.inf
    doubtful = abs(gamma - float(carried)) > COUPLING_SIGMAS * sigma
    used = carried != _better_otherwise(state, solution.hyper, near) if doubtful else carried
    likelier = 0.5 * (gamma**2 - (1.0 - gamma) ** 2) / sigma**2
    return TermTest("coupling", used, (gamma / sigma) ** 2, float(likelier), gamma, sigma)


def _better_otherwise(state: EstimatorState, hyper: Hyperparameters, near: Vector) -> bool:
    """Whether the residual of the pairs of a state is smaller with the other choice of distortion advection."""
    about = replace(state, linearisation_point=near)
    spreads = []
    for candidate in (state, with_static_distortion(about) if state.distortion.carried else with_advected_distortion(about)):
        fit = solve_shared(eliminate_all(candidate, hyper, near))
        fields = _map_residuals(candidate, mean_of(fit), fit.step[fit.chain.border.part(NOISE)])
        z = np.concatenate([(residual * np.sqrt(rows.weight)).ravel() for rows, residual in zip(candidate.rows, fields, strict=True)])
        spreads.append(float(np.mean(z**2)))
    return spreads[1] < spreads[0]


def _map_residuals(state: EstimatorState, mean: Vector, noise_px: Vector) -> list[Matrix]:
    """(blocks, 2) residual of each map for given parameters and given noise of frame 0, px."""
    noise = noise_px.reshape(2, -1).T
    return [rows.disparity_px - predicted(state, rows, mean) + (noise if rows.from_reference else 0.0) for rows in state.rows]


def rms_rotation(state: EstimatorState, mean: Vector, before_rad: float) -> float:
    """Root mean square rotation of the pairs with rigid motion, rad; `before_rad` if there are none."""
    at = rotation_indices(state)
    return max(float(np.sqrt(np.mean(mean[at] ** 2))), LEAST_RAD) if at.size else before_rad
