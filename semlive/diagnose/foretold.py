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

from semlive.diagnose.baseline import Ladder
from semlive.diagnose.evidence import left_in_common, pulled
from semlive.diagnose.refine import Refined
from semlive.model.effects.family import Again, Law

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What an effect says of a run.

    Attributes:
        name: of the effect.
        field_px: (f, b, 2, q) its columns.
        mean: (q,) amplitudes that are expected.
        spread: (q, q) factor L of their covariance L L^T.
        typical: (q,) amplitudes that the run has if the effect is there: those of the first run, where they or their course are the same.
        unsure: (q, q) factor of their covariance: what the first run left open of them, or all that they will be.
    """

    name: str
    field_px: Array
    mean: Array
    spread: Array
    typical: Array
    unsure: Array


NOTHING = Prediction("nothing", np.zeros((0, 0, 2, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))


def predicted(run: Ladder, before: Ladder, found: Refined) -> Prediction:
    """What an effect that was found in one run says of another; nothing of a run that cannot show it."""
    scene, family = run.design.observation.scene, found.family
    still = family.again is Again.ONCE or (family.again is Again.BY_MOVES and not scene.move_px.any())
    law = None if still else family.law(scene, dict(found.values))
    if law is None or not law.field_px.any():
        return replace(NOTHING, name=family.name)
    if family.again is Again.ALIKE and law.scatter is None:
        spread = np.asarray(np.linalg.cholesky(found.covariance), dtype=np.float64)
        return Prediction(family.name, law.meaning(found.law).field_px, found.amplitudes, spread, found.amplitudes, spread)
    going_on = family.again is Again.GOING_ON
    longer = scene.end_s / before.design.observation.scene.end_s if going_on else 1.0
    sizes, none = np.diag(longer * _sizes(law, found)), np.zeros(law.field_px.shape[-1])
    if going_on:
        return Prediction(family.name, law.field_px, none, sizes, longer * found.amplitudes, 0.0 * sizes)
    return Prediction(family.name, law.field_px, none, sizes, none, sizes)


def _sizes(law: Law, found: Refined) -> Array:
    """(q,) root mean square of the amplitudes: each of its own where they are as many as were found, else of all of them."""
    square = found.amplitudes**2 + np.diag(found.covariance)
    count = law.field_px.shape[-1]
    return np.sqrt(square if law.scatter is None and len(square) == count else np.full(count, square.mean()))


def expected_odds(run: Ladder, rivals: Sequence[Prediction]) -> Array:
    """(n, n) expected logarithm of the odds for a rival against another, where the first is true.

    Args:
        run: baseline of the run to come, of one rung.
        rivals: n of them.
    """
    common, at = left_in_common(run, _side_by_side(rivals)), _places(rivals)
    n = len(rivals)
    said = np.zeros((n, n))
    for i, (true, here) in enumerate(zip(rivals, at, strict=True)):
        for j, (other, there) in enumerate(zip(rivals, at, strict=True)):
            own, shared = common[there, there], common[there, here]
            along = shared @ true.unsure
            said[i, j] = _log_p(own, shared @ true.typical, own + along @ along.T, other)
    return np.diag(said)[:, None] - said


def odds(run: Ladder, rivals: Sequence[Prediction]) -> Array:
    """(n, n) logarithm of the odds for a rival against another that the data of a run give."""
    best = Ladder(run.design, run.left, (run.best,))
    fields, at = _side_by_side(rivals), _places(rivals)
    common, pull = left_in_common(best, fields), pulled(best, fields)
    said = np.array([_log_p(common[own, own], pull[own], 0.0 * common[own, own], one) for one, own in zip(rivals, at, strict=True)])
    return np.asarray(said[:, None] - said)


def _side_by_side(rivals: Sequence[Prediction]) -> Array:
    return np.concatenate([one.field_px for one in rivals if len(one.mean)], axis=-1)


def _places(rivals: Sequence[Prediction]) -> list[slice]:
    ends = np.cumsum([len(one.mean) for one in rivals])
    return [slice(int(end) - len(one.mean), int(end)) for end, one in zip(ends, rivals, strict=True)]


def _log_p(own: Array, pull: Array, scatter: Array, one: Prediction) -> float:
    """Expected logarithm of the likelihood against nothing hidden, of data that ask for (q,) `pull` with a covariance (q, q)."""
    off, inner = pull - own @ one.mean, np.eye(len(pull)) + one.spread.T @ own @ one.spread
    asked = one.spread.T @ off
    inverse = np.linalg.inv(inner)
    square = float(asked @ inverse @ asked + np.trace(inverse @ one.spread.T @ scatter @ one.spread))
    return float(pull @ one.mean) - 0.5 * float(one.mean @ own @ one.mean) + 0.5 * square - 0.5 * float(np.linalg.slogdet(inner)[1])
