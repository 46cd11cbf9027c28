"""What a score calls an error where there is none to be had: maps without noise, through pipeline and comparison."""

from __future__ import annotations

import numpy as np
import pytest
from numexp.asrun import concluded, truth
from numexp.cases import CASES
from numexp.experiment import make_experiment

from semlive.data.grid import Grid
from semlive.data.settings import AnalysisSettings, DicSettings, EstimateSettings, SpecimenSettings
from semlive.report.scoring.errors import RunErrors, compare_with_truth
from semlive.report.scoring.truth import Truth

GRID = Grid(101, 101, 15, 50, 40, 43)


@pytest.fixture(scope="module", params=[4])
def errors(request: pytest.FixtureRequest) -> RunErrors:
    experiment = make_experiment(CASES["exact"], request.param, GRID, 9)
    settings = AnalysisSettings(
        dic=DicSettings(step_px=GRID.step_px), estimate=EstimateSettings(window_points=5), specimen=SpecimenSettings("", 10.0, "y")
    )
    return compare_with_truth(concluded(experiment, settings), Truth.of(truth(experiment)))


def test_motion_is_judged_in_the_gauge_in_which_it_is_determined(errors: RunErrors) -> None:
    """With the affine part B of the distortion counted on the wrong side, shifts are B d off: 0.02 px with drift of 10 px."""
    worst = np.max([np.abs(item.measured_px - item.true_px) for item in errors.shifts], axis=0)
    assert worst[1] < 1e-3
    assert worst[0] < 1e-3


def test_drift_within_frames_is_judged_in_its_gauge(errors: RunErrors) -> None:
    assert np.max([np.abs(item.error_px) for item in errors.drift]) < 1e-4


def test_distortion_displacement_and_strain_have_no_error_of_their_own(errors: RunErrors) -> None:
    """3e-3 px of the distortion are the spline's, where it bends most at the grid's edge."""
    assert np.abs(errors.distortion.error_px).max() < 5e-3
    assert np.max([np.abs(item.displacement_px).max() for item in errors.frames]) < 1e-4
    assert np.max([np.abs(item.mean_strain - item.true_strain) for item in errors.frames]) < 1e-7
