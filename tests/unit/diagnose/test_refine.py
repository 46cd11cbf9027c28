"""How large an effect is and how well that is known, against what was hidden."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.hiding import hidden_effect, hidden_values
from blind.observing import QUICK, observed

from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.bayes_factor import ProjectedField, project, score_candidates
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.maps.linear_parameters import LinearParameterSums
from semlive.diagnose.maps.parameter_search import parameter_spread
from semlive.diagnose.maps.refinement import RefinedEffect, refined, refit_jointly
from semlive.model.effects import EFFECT_CLASSES, EffectClass, NonlinearParameter
from semlive.model.effects.effect_class import Values
from semlive.model.effects.maps.image_field import AFFINE
from semlive.service.diagnosis.verdict_json import parameters_json
from semlive_simulators.effects.drift import ThermalOscillation

GRID = Grid(101, 101, 60, 12, 10, 43)
CLOSE = Grid(101, 101, 15, 50, 40, 43)


def hiding(name: str, peak_px: float, seed: int, grid: Grid = GRID, subset_px: int = 0) -> tuple[HyperparameterGrid, dict[str, float]]:
    effects, conditions = hidden_effect(name, peak_px, seed), Conditions(seed, calibration=5, tension=3, subset_px=subset_px)
    return noise_scaled_baseline(observed(conditions, effects, grid, QUICK)), hidden_values(name, effects[0])


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
    baseline, truth = hiding("drift_jump", 0.5, 2, CLOSE, CLOSE.subset_px)
    found = values_and_sigmas(likeliest(baseline, "drift_jump"))
    for name, true in truth.items():
        value, sigma = found[name]
        assert value == pytest.approx(true, abs=0.02)
        assert abs(value - true) < 3.0 * sigma


@pytest.mark.parametrize("seed", [1, 5])
def test_a_period_near_the_interval_of_the_frames_is_one_of_the_values_that_are_reported(seed: int) -> None:
    """One frame per 214.7 s: periods near it, its half and its third differ little at the frames, and the drift follows most of them."""
    effect = ThermalOscillation(0.0145, 0.0194, 213.24, 1.52)
    conditions = Conditions(seed, calibration=8, tension=7, noise_px=0.0123)
    period = likeliest(noise_scaled_baseline(observed(conditions, (effect,), GRID, QUICK)), "thermal_oscillation").parameters[-1]
    assert period.name == "period_s"
    first, *_ = period.alternatives
    assert parameters_json((period,))["period_s"]["alternatives"][0] == {"value": first[0], "sigma": first[1]}
    assert min(abs(value - 213.24) / sigma for value, sigma in ((period.value, period.sigma), *period.alternatives)) < 3.0
    other = replace(effect, period_s=150.0)
    period = likeliest(noise_scaled_baseline(observed(conditions, (other,), GRID, QUICK)), "thermal_oscillation").parameters[-1]
    assert abs(period.value - 150.0) < 3.0 * period.sigma
    assert period.alternatives == ()
    assert set(parameters_json((period,))["period_s"]) == {"value", "sigma", "unit"}


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


PRECISION = 400.0 * np.array([[1.0, 0.9], [0.9, 1.0]])  # per squared step


@dataclass(frozen=True)
class CorrelatedPosterior:
    """Normal posterior of two parameters about (3, 7), in steps of the grid; the one amplitude is nearly constant."""

    family: EffectClass
    size_px: float = 1.0
    sums: None = None

    def grid(self) -> Iterable[Values]:
        return ({"first": 0.0, "second": 0.0}, {"first": 20.0, "second": 40.0})

    def evaluate(self, values: Values) -> ProjectedField:
        steps = np.array([values["first"] - 3.0, 0.5 * (values["second"] - 7.0)])
        gradient = np.sqrt(4e4 - 2.0 * steps @ PRECISION @ steps)  # half of its square over 1 + information is the log posterior
        return ProjectedField(np.ones((1, 1)), np.ones((1, 1, 1)), np.array([[gradient]]))


def test_correlated_parameters_are_as_uncertain_as_their_joint_posterior() -> None:
    """With each varied alone their uncertainties are 2.3 times too small."""
    parameters = (NonlinearParameter("first", "s", 1.0), NonlinearParameter("second", "s", 2.0))
    family = EffectClass("correlated", "", lambda scene, values: None, nonlinear_parameters=parameters)
    spread = parameter_spread(CorrelatedPosterior(family), {"first": 3.0, "second": 7.0}, np.array([100.0]))
    expected = np.sqrt(np.diag(np.linalg.inv(PRECISION))) * [1.0, 2.0]
    assert spread.sigmas == pytest.approx(expected, rel=0.05)
    assert np.prod(spread.widths_steps) == pytest.approx(np.linalg.det(PRECISION) ** -0.5, rel=0.05)
