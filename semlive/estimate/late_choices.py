"""Choices of a long run that concern what all pairs share: the noise, and the smoothness of the distortion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from semlive.estimate.accumulate import predicted
from semlive.estimate.arrow import steady
from semlive.estimate.border import DISTORTION, Vector, border_belief, joint_of
from semlive.estimate.chain import Chain, concluded
from semlive.estimate.evidence import DISTORTION_CANDIDATES, DISTORTION_ORDERS, Known, Misfit, smoothest
from semlive.estimate.prior import GAUGE_PX, Hyper
from semlive.estimate.state import EstimatorState, rows_of

ENOUGH_PAIRS = 32
CLIP = 4.0


def noise_ratio(state: EstimatorState, mean: Vector, noise_px: Vector, since: int) -> float:
    """How much larger the residuals of all pairs are than those of the first `since`, which the noise scale is known from.

    Each is judged from some pairs evenly over them. What the estimate takes out of the residuals, some 2 %, it takes out of both.

    Args:
        state: the data, linearised about `mean`.
        mean: (n,) estimate.
        noise_px: (2 blocks,) estimate of the noise of frame 0, first x, then y.
        since: number of pairs.
    """
    every = (0, *state.motions.pairs)
    return _spread(state, mean, noise_px, every) / _spread(state, mean, noise_px, every[:since])


def distortion_rechosen(chain: Chain) -> Hyper:
    """The likeliest smoothness of the distortion, all pairs' drift and motions and the noise of frame 0 integrated out."""
    state, hyper, border, spline = chain.state, chain.hyper, chain.border, chain.state.distortion
    _, lower, pull = concluded(chain)
    precision = np.tril(lower) + np.tril(lower, -1).T
    part, about = border.part(DISTORTION), chain.near[joint_of(state.layout, border.codes()[: border.known])]
    belief = border_belief(state, hyper, border)
    affine = spline.affine_rows(state.grid) / GAUGE_PX
    pinned = affine.T @ affine
    belief[part, part] = 0.0
    for axis in (0, 1):
        one = slice(axis, part.stop, 2)
        belief[one, one] = pinned
    precision += belief
    pull = pull.copy()
    pull[: border.known] -= belief[: border.known, : border.known] @ about
    rest = slice(part.stop, border.size)
    gone = np.linalg.solve(steady(precision[rest, rest]), np.column_stack((precision[rest, part], pull[rest])))
    own = precision[part, part] - precision[part, rest] @ gone[:, :-1]
    asked = pull[part] - precision[part, rest] @ gone[:, -1]
    known = Known(spline, pinned)
    parts = (slice(axis, None, 2) for axis in (0, 1))
    data = (Misfit(own[one, one], asked[one], about[part][one]) for one in parts)
    x, y = (smoothest(one, known, DISTORTION_ORDERS, DISTORTION_CANDIDATES) for one in data)
    return replace(hyper, distortion=(x, y))


def _spread(state: EstimatorState, mean: Vector, noise_px: Vector, pairs: tuple[int, ...]) -> float:
    """Root mean square of normalised residuals, outliers clipped."""
    at = np.unique(np.linspace(0, len(pairs) - 1, ENOUGH_PAIRS).astype(int))
    taken, noise = {pairs[one] for one in at}, noise_px.reshape(2, -1).T
    found = []
    for rows in rows_of(state, taken):
        if rows.weight.any():
            residual = rows.disparity_px - predicted(state, rows, mean) + (noise if rows.from_reference else 0.0)
            found.append((residual * np.sqrt(rows.weight))[rows.weight > 0])
    joined = np.concatenate(found)
    limit = CLIP * 1.4826 * float(np.median(np.abs(joined)))
    return max(float(np.sqrt(np.mean(np.clip(joined, -limit, limit) ** 2))), np.finfo(float).tiny)
