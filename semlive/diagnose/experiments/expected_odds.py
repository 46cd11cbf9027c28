"""Expected log odds between effects for a planned experiment.

The first run predicts each effect in the planned run: amplitudes that are equal in every run with their uncertainty, other amplitudes with
their size only. For data ``y = Z_i a_i + noise`` with effect i, the expectation of ``ln p(y | i) - ln p(y | j)`` has a closed form, the
distinguishability of the two effects (Eriksson, Frisk and Krysander 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import gradient_of, residual_gram
from semlive.diagnose.maps.refinement import RefinedEffect
from semlive.model.effects.effect_class import BasisField, Recurrence

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Prediction of an effect in a run.

    Attributes:
        name: name of the effect.
        field_px: (f, b, 2, q) columns of the effect, px.
        mean: (q,) expected amplitudes.
        covariance_factor: (q, q) factor L of their covariance L L^T.
        typical_amplitudes: (q,) amplitudes if the effect is true: those of the first run, where they or their time series recur.
        uncertainty_factor: (q, q) factor of their covariance: the uncertainty from the first run, or the full prior.
    """

    name: str
    field_px: Array
    mean: Array
    covariance_factor: Array
    typical_amplitudes: Array
    uncertainty_factor: Array


NOTHING = Prediction("nothing", np.zeros((0, 0, 2, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))


def predict_effect(run: HyperparameterGrid, before: HyperparameterGrid, effect: RefinedEffect) -> Prediction:
    """Prediction of an effect of one run in another run; an empty prediction if the effect is not observable there."""
    scene, family = run.design.observation.geometry, effect.family
    not_observable = family.recurrence is Recurrence.ONE_TIME or (
        family.recurrence is Recurrence.FOLLOWS_MOVES and not scene.steps.move_px.any()
    )
    basis_field = None if not_observable else family.basis_field(scene, dict(effect.values))
    if basis_field is None or not basis_field.field_px.any():
        return replace(NOTHING, name=family.name)
    if family.recurrence is Recurrence.SAME_AMPLITUDE and basis_field.random_amplitude is None:
        spread = np.asarray(np.linalg.cholesky(effect.covariance), dtype=np.float64)
        return Prediction(family.name, basis_field.rescaled_to(effect.field).field_px, effect.amplitudes, spread, effect.amplitudes, spread)
    continues = family.recurrence is Recurrence.CONTINUES
    longer = scene.end_s / before.design.observation.geometry.end_s if continues else 1.0
    sizes, none = np.diag(longer * _sizes(basis_field, effect)), np.zeros(basis_field.field_px.shape[-1])
    if continues:
        return Prediction(family.name, basis_field.field_px, none, sizes, longer * effect.amplitudes, 0.0 * sizes)
    return Prediction(family.name, basis_field.field_px, none, sizes, none, sizes)


def _sizes(basis_field: BasisField, effect: RefinedEffect) -> Array:
    """(q,) root mean square of the amplitudes: separately if both runs have as many amplitudes, else the mean over all."""
    square = effect.amplitudes**2 + np.diag(effect.covariance)
    count = basis_field.field_px.shape[-1]
    return np.sqrt(square if basis_field.random_amplitude is None and len(square) == count else np.full(count, square.mean()))


def expected_odds(run: HyperparameterGrid, rivals: Sequence[Prediction]) -> Array:
    """(n, n) expected log odds for each effect against each other effect, if the first of them is true.

    Args:
        run: baseline of the planned run, with one point.
        rivals: predictions of the n effects.
    """
    common, at = residual_gram(run, _stack_fields(rivals)), _places(rivals)
    n = len(rivals)
    odds = np.zeros((n, n))
    for i, (true, true_span) in enumerate(zip(rivals, at, strict=True)):
        for j, (rival, rival_span) in enumerate(zip(rivals, at, strict=True)):
            own, shared = common[rival_span, rival_span], common[rival_span, true_span]
            along = shared @ true.uncertainty_factor
            odds[i, j] = _log_p(own, shared @ true.typical_amplitudes, own + along @ along.T, rival)
    return np.diag(odds)[:, None] - odds


def log_odds(run: HyperparameterGrid, rivals: Sequence[Prediction]) -> Array:
    """(n, n) log odds for each effect against each other effect from the data of a run."""
    best = HyperparameterGrid(run.design, run.whitened_residual, (run.best,))
    fields, at = _stack_fields(rivals), _places(rivals)
    common, gradient = residual_gram(best, fields), gradient_of(best, fields)
    log_p = np.array(
        [_log_p(common[own, own], gradient[own], 0.0 * common[own, own], rival) for rival, own in zip(rivals, at, strict=True)]
    )
    return np.asarray(log_p[:, None] - log_p)


def _stack_fields(rivals: Sequence[Prediction]) -> Array:
    return np.concatenate([rival.field_px for rival in rivals if len(rival.mean)], axis=-1)


def _places(rivals: Sequence[Prediction]) -> list[slice]:
    ends = np.cumsum([len(rival.mean) for rival in rivals])
    return [slice(int(end) - len(rival.mean), int(end)) for end, rival in zip(ends, rivals, strict=True)]


def _log_p(own: Array, gradient: Array, scatter: Array, prediction: Prediction) -> float:
    """Expected log likelihood ratio against no effect, for data with a gradient (q,) and its covariance (q, q)."""
    residual_gradient, inner = (
        gradient - own @ prediction.mean,
        np.eye(len(gradient)) + prediction.covariance_factor.T @ own @ prediction.covariance_factor,
    )
    factor_gradient = prediction.covariance_factor.T @ residual_gradient
    inverse = np.linalg.inv(inner)
    square = float(
        factor_gradient @ inverse @ factor_gradient
        + np.trace(inverse @ prediction.covariance_factor.T @ scatter @ prediction.covariance_factor)
    )
    return (
        float(gradient @ prediction.mean)
        - 0.5 * float(prediction.mean @ own @ prediction.mean)
        + 0.5 * square
        - 0.5 * float(np.linalg.slogdet(inner)[1])
    )
