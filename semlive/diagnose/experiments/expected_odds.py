"""What an experiment would decide between effects, before it is made: the logarithm of the odds that it is expected to give.

Each effect predicts the run to come by what the first run said of it: amplitudes that are the same in every run with their uncertainty,
others with their size alone. Of data ``y = Z_i a_i + noise``, made by one of them as large as it was, the expectation of
``ln p(y | i) - ln p(y | j)`` is a closed form: how well the two can be told apart (distinguishability, Eriksson, Frisk and Krysander 2013).
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
    """What an effect says of a run.

    Attributes:
        name: of the effect.
        field_px: (f, b, 2, q) its columns.
        mean: (q,) amplitudes that are expected.
        covariance_factor: (q, q) factor L of their covariance L L^T.
        typical_amplitudes: (q,) amplitudes of the run with the effect: those of the first run, where they or their time series agree.
        uncertainty_factor: (q, q) factor of their covariance: what the first run left open of them, or all that they will be.
    """

    name: str
    field_px: Array
    mean: Array
    covariance_factor: Array
    typical_amplitudes: Array
    uncertainty_factor: Array


NOTHING = Prediction("nothing", np.zeros((0, 0, 2, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))


def predict_effect(run: HyperparameterGrid, before: HyperparameterGrid, found: RefinedEffect) -> Prediction:
    """What an effect that was found in one run says of another; nothing of a run that cannot show it."""
    scene, family = run.design.observation.geometry, found.family
    still = family.recurrence is Recurrence.ONE_TIME or (family.recurrence is Recurrence.FOLLOWS_MOVES and not scene.move_px.any())
    basis_field = None if still else family.basis_field(scene, dict(found.values))
    if basis_field is None or not basis_field.field_px.any():
        return replace(NOTHING, name=family.name)
    if family.recurrence is Recurrence.SAME_AMPLITUDE and basis_field.random_amplitude is None:
        spread = np.asarray(np.linalg.cholesky(found.covariance), dtype=np.float64)
        return Prediction(family.name, basis_field.rescaled_to(found.field).field_px, found.amplitudes, spread, found.amplitudes, spread)
    going_on = family.recurrence is Recurrence.CONTINUES
    longer = scene.end_s / before.design.observation.geometry.end_s if going_on else 1.0
    sizes, none = np.diag(longer * _sizes(basis_field, found)), np.zeros(basis_field.field_px.shape[-1])
    if going_on:
        return Prediction(family.name, basis_field.field_px, none, sizes, longer * found.amplitudes, 0.0 * sizes)
    return Prediction(family.name, basis_field.field_px, none, sizes, none, sizes)


def _sizes(basis_field: BasisField, found: RefinedEffect) -> Array:
    """(q,) root mean square of the amplitudes: each of its own where they are as many as were found, else of all of them."""
    square = found.amplitudes**2 + np.diag(found.covariance)
    count = basis_field.field_px.shape[-1]
    return np.sqrt(square if basis_field.random_amplitude is None and len(square) == count else np.full(count, square.mean()))


def expected_odds(run: HyperparameterGrid, rivals: Sequence[Prediction]) -> Array:
    """(n, n) expected logarithm of the odds for a rival against another, where the first is true.

    Args:
        run: baseline of the run to come, of one rung.
        rivals: n of them.
    """
    common, at = residual_gram(run, _side_by_side(rivals)), _places(rivals)
    n = len(rivals)
    odds = np.zeros((n, n))
    for i, (true, here) in enumerate(zip(rivals, at, strict=True)):
        for j, (rival, there) in enumerate(zip(rivals, at, strict=True)):
            own, shared = common[there, there], common[there, here]
            along = shared @ true.uncertainty_factor
            odds[i, j] = _log_p(own, shared @ true.typical_amplitudes, own + along @ along.T, rival)
    return np.diag(odds)[:, None] - odds


def log_odds(run: HyperparameterGrid, rivals: Sequence[Prediction]) -> Array:
    """(n, n) logarithm of the odds for a rival against another that the data of a run give."""
    best = HyperparameterGrid(run.design, run.whitened_residual, (run.best,))
    fields, at = _side_by_side(rivals), _places(rivals)
    common, pull = residual_gram(best, fields), gradient_of(best, fields)
    log_p = np.array([_log_p(common[own, own], pull[own], 0.0 * common[own, own], rival) for rival, own in zip(rivals, at, strict=True)])
    return np.asarray(log_p[:, None] - log_p)


def _side_by_side(rivals: Sequence[Prediction]) -> Array:
    return np.concatenate([rival.field_px for rival in rivals if len(rival.mean)], axis=-1)


def _places(rivals: Sequence[Prediction]) -> list[slice]:
    ends = np.cumsum([len(rival.mean) for rival in rivals])
    return [slice(int(end) - len(rival.mean), int(end)) for end, rival in zip(ends, rivals, strict=True)]


def _log_p(own: Array, pull: Array, scatter: Array, prediction: Prediction) -> float:
    """Expected logarithm of the likelihood against nothing hidden, of data that ask for (q,) `pull` with a covariance (q, q)."""
    off, inner = pull - own @ prediction.mean, np.eye(len(pull)) + prediction.covariance_factor.T @ own @ prediction.covariance_factor
    gradient = prediction.covariance_factor.T @ off
    inverse = np.linalg.inv(inner)
    square = float(
        gradient @ inverse @ gradient + np.trace(inverse @ prediction.covariance_factor.T @ scatter @ prediction.covariance_factor)
    )
    return (
        float(pull @ prediction.mean)
        - 0.5 * float(prediction.mean @ own @ prediction.mean)
        + 0.5 * square
        - 0.5 * float(np.linalg.slogdet(inner)[1])
    )
