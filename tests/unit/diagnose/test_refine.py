"""How large an effect is and how well that is known, against what was hidden."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from blind.experiment import GRID as PAPERS
from blind.experiment import Conditions
from blind.hiding import hidden_effect, hidden_values
from blind.observing import observed

from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.bayes_factor import project, score_candidates
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.maps.linear_parameters import LinearParameterSums
from semlive.diagnose.maps.refinement import RefinedEffect, refined, refit_jointly
from semlive.model.effects import EFFECT_CLASSES
from semlive.model.effects.maps.image_field import AFFINE

GRID = Grid(101, 101, 60, 12, 10, 43)


def hiding(name: str, peak_px: float, seed: int, grid: Grid = GRID) -> tuple[HyperparameterGrid, dict[str, float]]:
    effects = hidden_effect(name, peak_px, seed)
    return noise_scaled_baseline(observed(Conditions(seed, calibration=5, tension=3), effects, grid)), hidden_values(name, effects[0])


def likeliest(baseline: HyperparameterGrid, name: str) -> RefinedEffect:
    (received,) = score_candidates(baseline, [effect_class(name)])
    return refined(baseline, received)


def values_and_sigmas(found: RefinedEffect) -> dict[str, tuple[float, float]]:
    return {item.name: (item.value, item.sigma) for item in found.parameters}


def test_an_amplitude_is_as_uncertain_as_the_onset_that_it_goes_with() -> None:
    off = []
    for seed in (1, 2, 3):
        baseline, truth = hiding("creep_in_hold", 0.3, seed)
        found = likeliest(baseline, "creep_in_hold")
        value, sigma = values_and_sigmas(found)["strain_per_n"]
        off.append((value - truth["strain_per_n"]) / sigma)
        assert sigma < 0.5 * value
        assert 0.5 <= values_and_sigmas(found)["onset_s"][0] <= 520.0
        assert found.parameter_covariance[0, 0] > 2.0 * (found.covariance - found.parameter_covariance)[0, 0]
    assert np.max(np.abs(off)) < 2.6
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_a_large_jump_between_grid_instants_has_its_true_size() -> None:
    baseline, truth = hiding("drift_jump", 0.5, 2, PAPERS)
    found = values_and_sigmas(likeliest(baseline, "drift_jump"))
    for name, true in truth.items():
        value, sigma = found[name]
        assert value == pytest.approx(true, abs=0.02)
        assert abs(value - true) < 3.0 * sigma


def test_refitted_next_to_no_other_an_effect_is_as_large_as_it_was() -> None:
    baseline, _ = hiding("load_step_transient", 0.15, 5)
    alone = likeliest(baseline, "load_step_transient")
    with_effects = build_grid(baseline.design.with_effects(alone.baseline_effect))
    (joint,) = refit_jointly(with_effects, [alone])
    assert joint.amplitudes == pytest.approx(alone.amplitudes, rel=1e-3)
    assert joint.covariance == pytest.approx(alone.covariance, rel=1e-2, abs=1e-3 * float(alone.covariance.max()))
    assert joint.parameters[-1] == alone.parameters[-1]


def test_effects_are_refitted_next_to_each_other() -> None:
    """Creep alone takes the residual of the fading steps; with both in the model, it does not."""
    names = ("load_step_transient", "creep_in_hold")
    effects = tuple(item for name in names for item in hidden_effect(name, 0.2, 6))
    baseline = noise_scaled_baseline(observed(Conditions(6, calibration=5, tension=3), effects, GRID))
    found = [likeliest(baseline, name) for name in names]
    with_effects = baseline.design
    for item in found:
        with_effects = with_effects.with_effects(item.baseline_effect)
    joint = refit_jointly(build_grid(with_effects), found)
    for name, effect, item in zip(names, effects, joint, strict=True):
        for parameter, true in hidden_values(name, effect).items():
            value, sigma = values_and_sigmas(item)[parameter]
            assert abs(value - true) < 3.0 * sigma, f"{name} {parameter}: {value} +- {sigma}, hidden {true}"


@pytest.fixture(scope="module")
def scaling() -> HyperparameterGrid:
    return hiding("distortion_scale_drift", 0.2, 3)[0]


def test_a_model_that_is_a_sum_equals_the_sum_of_its_columns(scaling: HyperparameterGrid) -> None:
    baseline = scaling
    family, values = effect_class("distortion_scale_drift"), dict(zip(AFFINE, (0.4, -0.7, 0.2, 1.1), strict=True))
    sums = LinearParameterSums.of(baseline, family)
    law = family.basis_field(baseline.design.observation.geometry, values)
    assert sums is not None
    assert law is not None
    summed, whole = sums.at(values), project(baseline, law.field_px)
    sizes_px = np.geomspace(0.003, 1.0, 5)
    assert summed.log_factor(sizes_px) == pytest.approx(whole.log_factor(sizes_px), rel=1e-6, abs=1e-6)
    for item, other in zip(sums.at_point(0).at(values).amplitudes(0, 0.1), whole.amplitudes(0, 0.1), strict=True):
        assert item == pytest.approx(other, rel=1e-5, abs=1e-9)
    assert LinearParameterSums.of(baseline, effect_class("thermal_oscillation")) is None


def test_only_what_is_linear_is_a_sum(scaling: HyperparameterGrid) -> None:
    """For every family with this property: the mean of the columns of two values lies half way between them."""
    scene = scaling.design.observation.geometry
    for family in (item for item in EFFECT_CLASSES if item.linear_in_parameters):
        for name in (item.name for item in family.nonlinear_parameters):
            low, half, high = (family.basis_field(scene, {name: value}) for value in (0.0, 0.5, 1.0))
            assert low is not None
            assert half is not None
            assert high is not None
            assert half.field_px == pytest.approx(0.5 * (low.field_px + high.field_px), abs=1e-12)
