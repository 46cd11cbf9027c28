"""Thinning of runs that are longer than one matrix: pairs spread over the run, and a drift with as many knots as for them.

Consecutive blocks of pairs were not chosen: the distortion is determined by the calibration at the start of a run, and slow effects by its
entire length.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.observations.accumulation import DENSE_PAIRS
from semlive.service.log.pairs import topic_counts

T = TypeVar("T")
FIRST_PAIRS, OTHER_PAIRS = 9, 11
"""First pairs, mostly of the calibration, and others of a thinned run: a verdict takes as long as for 20 pairs, whatever the length."""


def pair_count(log: Path) -> int:
    """Number of pairs in a log by its summary; 0 if it has none."""
    return (topic_counts(log) or {}).get("/pair", 0)


def stride(count: int) -> int:
    """Distance of the retained pairs after the first ones in a run of `count` pairs; 1 if all pairs are retained."""
    return math.ceil((count - FIRST_PAIRS) / OTHER_PAIRS) if count > DENSE_PAIRS else 1


def thinned(pairs: Iterable[T], count: int) -> Iterator[T]:
    """Yield all pairs of a run of `count` pairs, or the first pairs and others at equal distances."""
    every = stride(count)
    for place, pair in enumerate(pairs):
        if place < FIRST_PAIRS or (place - FIRST_PAIRS) % every == every - 1 or every == 1:
            yield pair


def coarser_drift(settings: EstimateSettings, count: int) -> EstimateSettings:
    """Settings with knots of the drift as far apart as a thinned run of `count` pairs allows."""
    if stride(count) == 1:
        return settings
    return replace(settings, drift_knots_per_frame=settings.drift_knots_per_frame * (FIRST_PAIRS + OTHER_PAIRS) / count)
