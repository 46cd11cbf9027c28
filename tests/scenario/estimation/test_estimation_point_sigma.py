"""The systematic part of a point's uncertainty: errors of the correction at points without noise are as large as is stated."""

from __future__ import annotations

import numpy as np
import pytest
from numexp.coverage import CALIBRATION_PAIRS, GRID, SMALL
from numexp.experiment import Experiment, make_experiment
from numexp.world import HEIGHT_PX, WIDTH_PX

from semlive import estimate, mechanics
from semlive.data.settings import EstimateSettings
from semlive.estimate import Solution


def solved(experiment: Experiment) -> Solution:
    state = estimate.init(EstimateSettings(), GRID, WIDTH_PX, HEIGHT_PX)
    for taken in experiment.pairs:
        state = estimate.update(state, taken.pair, taken.phase, taken.times, taken.maps)
    return estimate.solve(state)


@pytest.mark.parametrize("case", ["correlated", "wander"])
def test_a_correction_errs_at_points_by_what_is_stated(case: str) -> None:
    z = []
    for seed in (1, 2, 3):
        experiment = make_experiment(SMALL[case], seed, GRID, CALIBRATION_PAIRS)
        solution = solved(experiment)
        for observed in (observed for taken in experiment.pairs for observed in taken.observed):
            noisy = next(
                item
                for item in experiment.pairs[observed.exact.current // 2].maps
                if (0, observed.exact.current) == (item.reference, item.current)
            )
            sigma = np.stack(next(estimate.correction_sigmas(solution, (noisy,))), axis=-1)
            moved = mechanics.displacement(observed.exact, estimate.correction(solution, observed.exact))
            error = (np.stack((moved.u_px, moved.v_px), axis=-1) - observed.displacement_px)[moved.valid]
            z.append((error - error.mean(axis=0)) / sigma[moved.valid])
    assert 0.6 < np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.15


def test_it_is_reported_of_maps_from_frame_0_alone() -> None:
    experiment = make_experiment(SMALL["white"], 1, GRID, 3)
    with pytest.raises(ValueError, match="from frame 0, not from frame 2"):
        next(estimate.correction_sigmas(solved(experiment), experiment.pairs[1].maps[:1]))
