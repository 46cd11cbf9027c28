"""The paper's numerical experiment in short: one seed on a grid three times as coarse; docs/validation/estimation.md has the long form."""

from __future__ import annotations

import numpy as np
import pytest
from numexp.cases import CASES, magnification_growth
from numexp.experiment import make_experiment
from numexp.measure import Measured, measure
from numexp.methods import METHODS
from numexp.world import SCAN, start_s

from semlive.data.grid import Grid

GRID = Grid(101, 101, 15, 50, 40, 43)
RUNS = (
    ("smooth", 1),
    ("correlated", 1),
    ("exact", 1),
    ("paper", 1),
    ("wander", 1),
    ("magnification", 1),
    ("tension", 1),
)
COMPARED = ("sutton2007", "joint")
Results = dict[tuple[str, str], list[Measured]]


@pytest.fixture(scope="module")
def results() -> Results:
    found: Results = {}
    for case, seed in RUNS:
        experiment = make_experiment(CASES[case], seed, GRID)
        methods = METHODS if (case, seed) == RUNS[0] else COMPARED
        for method in methods:
            found.setdefault((case, method), []).append(measure(experiment, METHODS[method](experiment)))
    return found


def worst(results: Results, case: str, method: str, name: str) -> float:
    return max(float(np.abs(getattr(item, name)).max()) for item in results[case, method])


def test_without_correction_of_drift_there_is_a_false_strain_of_a_thousandth(results: Results) -> None:
    assert worst(results, "smooth", "uncorrected", "correction_max") > 3e-4
    assert 3e-4 < worst(results, "smooth", "no_drift", "correction_max") < 5e-3


def test_classical_forms_miss_a_wave(results: Results) -> None:
    assert worst(results, "smooth", "parametric", "distortion_max_px") > 10 * worst(results, "smooth", "joint", "distortion_max_px")


def test_the_published_procedure_reaches_its_published_figures(results: Results) -> None:
    """With smoothing of 60 px; white noise of a ninth of the points is three times as large after smoothing."""
    assert worst(results, "paper", "sutton2007", "correction_mean_strain") <= 6e-5
    assert worst(results, "paper", "sutton2007", "distortion_max_px") <= 3 * 0.04


def test_the_joint_method_holds_its_bars(results: Results) -> None:
    """Correlated noise does not care for the grid; of white noise a ninth of the points leave three times as much."""
    assert worst(results, "smooth", "joint", "distortion_max_px") <= 3 * 0.006
    assert worst(results, "smooth", "joint", "mean_strain") <= 3 * 8e-6
    assert worst(results, "smooth", "joint", "correction_mean_strain") <= 3 * 2e-6
    assert worst(results, "correlated", "joint", "distortion_max_px") <= 0.03
    assert worst(results, "correlated", "joint", "correction_sd") <= 4e-5
    assert worst(results, "exact", "joint", "correction_max") <= 1e-6
    assert worst(results, "exact", "joint", "correction_mean_strain") <= 1e-7


@pytest.mark.parametrize("case", ["smooth", "correlated", "exact", "paper", "wander", "magnification"])
@pytest.mark.parametrize("name", ["distortion_max_px", "correction_mean_strain", "correction_sd", "displacement_rms_px"])
def test_the_joint_method_beats_the_published_procedure(results: Results, case: str, name: str) -> None:
    assert worst(results, case, "joint", name) < worst(results, case, "sutton2007", name)


def test_magnification_that_drifts_is_recovered(results: Results) -> None:
    assert worst(results, "magnification", "joint", "correction_mean_strain") <= 1.5e-5
    found = results["magnification", "joint"][0].magnification
    assert found is not None
    middle_s = 0.5 * SCAN.frame_time_s
    assert found == pytest.approx(magnification_growth(middle_s, start_s(29) + middle_s), rel=0.03)


def test_the_joint_method_beats_the_published_procedure_under_load(results: Results) -> None:
    assert worst(results, "tension", "joint", "correction_mean_strain") < worst(results, "tension", "sutton2007", "correction_mean_strain")
    assert worst(results, "tension", "joint", "load_step_strain") < worst(results, "tension", "sutton2007", "load_step_strain")
