"""Conformal p-value for anything outside the catalogue, from the outcome of the maps.

The score of a verdict is the rank of its outcome: UNKNOWN, REJECTED, all others. An experiment of the calibration has at most listed
effects, and scores the highest rank of all its verdicts; verdicts of one experiment share their noise and are not exchangeable. If a new
experiment is exchangeable with these, its p-value is at most a with a probability of at most a, whatever the distribution of the score.
Experiments without an effect and with effects are calibrated separately, and the larger p-value counts. Source: Vovk, Gammerman and
Shafer, Algorithmic Learning in a Random World (2005), section 2.2.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.verdict import OutsideTest

SCORES = "outside_scores.json"  # written by `bench_diagnose.py --score --write`
RANKS = {Outcome.UNKNOWN: 2, Outcome.REJECTED: 1}  # all other outcomes have rank 0


def outside_test(outcome: Outcome) -> OutsideTest:
    """Test of the outcome of the maps against the stored scores."""
    groups = calibration_scores()
    return OutsideTest(max(conformal_p_value(rank(outcome), group) for group in groups), sum(len(group) for group in groups))


def rank(outcome: Outcome) -> int:
    """Score of a verdict."""
    return RANKS.get(outcome, 0)


def conformal_p_value(score: int, calibration: Sequence[int]) -> float:
    """Fraction of the scores, the new one included, that are at least as large."""
    return (1 + sum(other >= score for other in calibration)) / (len(calibration) + 1)


@cache
def calibration_scores() -> tuple[tuple[int, ...], ...]:
    """Scores of the experiments of each group: how often each rank occurs, in the stored table."""
    stored: dict[str, list[int]] = json.loads(files("semlive.diagnose.fit_tests").joinpath(SCORES).read_text(encoding="utf-8"))
    return tuple(tuple(score for score, count in enumerate(counts) for _ in range(count)) for counts in stored.values())
