"""The methods under test, through their public doors."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numexp.experiment import Experiment
from numexp.measure import Found

from semlive import estimate
from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction
from semlive.data.settings import EstimateSettings


def uncorrected(experiment: Experiment) -> Found:
    """Nothing is corrected."""
    return Found(None, _nothing)


def joint(experiment: Experiment) -> Found:
    """The joint least squares with its automatic settings."""
    state = estimate.init(EstimateSettings(), experiment.grid, 1024, 884)
    spent = []
    for taken in experiment.pairs:
        begin = time.process_time()
        state = estimate.update(state, taken.pair, taken.phase, taken.times, taken.maps)
        spent.append(time.process_time() - begin)
    begin = time.process_time()
    solution = estimate.solve(state)
    spent_s = time.process_time() - begin
    distortion = estimate.estimate(solution, len(experiment.pairs)).distortion
    return Found(distortion, lambda dmap: estimate.correction(solution, dmap), None, tuple(spent), spent_s)


METHODS: dict[str, Callable[[Experiment], Found]] = {"uncorrected": uncorrected, "joint": joint}


def _nothing(dmap: DisparityMap) -> Correction:
    zero = np.zeros(dmap.grid.shape)
    return Correction(dmap.current, zero, zero)
