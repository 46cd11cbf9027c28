"""Selection of shared hyperparameters in a long run: noise scale and smoothness of the distortion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semlive.estimate.joint.elimination.arrowhead import regularise
from semlive.estimate.joint.elimination.elimination import EliminationChain, eliminate_last
from semlive.estimate.joint.elimination.shared_parameters import DISTORTION, Vector, parameter_indices, shared_prior
from semlive.estimate.joint.observations.design_columns import predicted
from semlive.estimate.joint.observations.priors import GAUGE_PX, Hyperparameters
from semlive.estimate.joint.observations.state import EstimatorState, rows_of
from semlive.estimate.joint.selection.marginal_likelihood import (
    DISTORTION_CANDIDATES,
    DISTORTION_ORDERS,
    LocalLikelihood,
    SmoothnessPrior,
    select_smoothness,
)

ENOUGH_PAIRS = 32
CLIP = 4.0


def residual_noise_ratio(state: EstimatorState, mean: Vector, noise_px: Vector, since: int) -> float:
    """Ratio of the residuals of all pairs to those of the first `since` pairs, from which the noise scale was estimated.

    Both are computed from pairs distributed evenly. The fit reduces both by the same fraction of about 2 %.

    Args:
        state: the data, linearised about `mean`.
        mean: (n,) estimate of the joint parameters.
        noise_px: (2 blocks,) estimate of the noise of frame 0, px, first x, then y.
        since: number of first pairs.
    """
    every = (0, *state.motions.pairs)
    return _spread(state, mean, noise_px, every) / _spread(state, mean, noise_px, every[:since])


def reselect_distortion_smoothness(chain: EliminationChain) -> Hyperparameters:
    """Most likely smoothness of the distortion after marginalising drift and motions of all pairs and the noise of frame 0."""
    state, hyper, border, spline = chain.state, chain.hyper, chain.border, chain.state.distortion
    _, lower, pull = eliminate_last(chain)
    precision = np.tril(lower) + np.tril(lower, -1).T
    part, about = border.part(DISTORTION), chain.linearisation_point[parameter_indices(state.layout, border.codes()[: border.joint_size])]
    belief = shared_prior(state, hyper, border)
    affine = spline.affine_rows(state.grid) / GAUGE_PX
    pinned = affine.T @ affine
    belief[part, part] = 0.0
    for axis in (0, 1):
        component = slice(axis, part.stop, 2)
        belief[component, component] = pinned
    precision += belief
    pull = pull.copy()
    pull[: border.joint_size] -= belief[: border.joint_size, : border.joint_size] @ about
    remainder = slice(part.stop, border.size)
    eliminated = np.linalg.solve(
        regularise(precision[remainder, remainder]), np.column_stack((precision[remainder, part], pull[remainder]))
    )
    own = precision[part, part] - precision[part, remainder] @ eliminated[:, :-1]
    gradient = pull[part] - precision[part, remainder] @ eliminated[:, -1]
    prior = SmoothnessPrior(spline, pinned)
    parts = (slice(axis, None, 2) for axis in (0, 1))
    data = (LocalLikelihood(own[value, value], gradient[value], about[part][value]) for value in parts)
    x, y = (select_smoothness(value, prior, DISTORTION_ORDERS, DISTORTION_CANDIDATES) for value in data)
    return replace(hyper, distortion=(x, y))


def _spread(state: EstimatorState, mean: Vector, noise_px: Vector, pairs: tuple[int, ...]) -> float:
    """Root mean square of the normalised residuals, outliers clipped."""
    at = np.unique(np.linspace(0, len(pairs) - 1, ENOUGH_PAIRS).astype(int))
    sampled, noise = {pairs[index] for index in at}, noise_px.reshape(2, -1).T
    found = []
    for rows in rows_of(state, sampled):
        if rows.weight.any():
            residual = rows.disparity_px - predicted(state, rows, mean) + (noise if rows.from_reference else 0.0)
            found.append((residual * np.sqrt(rows.weight))[rows.weight > 0])
    joined = np.concatenate(found)
    limit = CLIP * 1.4826 * float(np.median(np.abs(joined)))
    return max(float(np.sqrt(np.mean(np.clip(joined, -limit, limit) ** 2))), np.finfo(float).tiny)
