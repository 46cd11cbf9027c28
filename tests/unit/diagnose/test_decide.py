"""What two runs with different scans decide that one cannot."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.observing import QUICK, observed
from numexp.world import SCAN

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.two_runs import TwoRunVerdict
from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import project
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import sample_within_blocks
from semlive.diagnose.two_runs.decide import compare_runs
from semlive.diagnose.two_runs.join import join_runs
from semlive.diagnose.two_runs.joint_evidence import relative_to_reference
from semlive.errors import IllPosed
from semlive.model.effects import EFFECT_CLASSES, TWO_RUN_EFFECT_CLASSES
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.scan_deflection import LineSyncHum
from semlive_simulators.effects.scan_timing import WrongRowTime
from semlive_simulators.effects.settling import FlybackSettling, FrameStartSettling
from semlive_simulators.microscope.scan import Scan

GRID = Grid(56, 56, 60, 15, 12, 43)  # a block is a point
FINE = Grid(56, 56, 15, 60, 50, 43)
HALF = replace(SCAN, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)


@cache
def run(
    seed: int, effects: tuple[Effect, ...] = (), scan: Scan = SCAN, bent_like: int | None = None, grid: Grid = GRID
) -> HyperparameterGrid:
    """Baseline of a run; several tests have the same first run, or the same second one."""
    return noise_scaled_baseline(
        observed(Conditions(seed, tension=0, scan=scan, bent_like=bent_like, subset_px=grid.subset_px), effects, grid, QUICK)
    )


def decided(seed: int, *effects: Effect) -> TwoRunVerdict:
    return compare_runs((run(seed, effects), run(seed + 1000, effects, HALF, seed)))


def values_and_sigmas(found: TwoRunVerdict) -> dict[str, tuple[float, float]]:
    assert found.effect is not None
    return {item.name: (item.value, item.sigma) for item in found.effect.parameters}


def test_a_distortion_that_both_scans_have_is_nothing() -> None:
    found = decided(41)
    assert (found.outcome, found.effect, found.ambiguous) == (Outcome.NONE, None, ())
    assert found.separate_log_odds < 0.0
    assert max(factor for _, factor in found.evidence) < 7.0


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (FlybackSettling(0.5, 4e-3), {"amplitude_px": 0.5, "settling_s": 4e-3}),
        (FrameStartSettling(0.3, -0.4, 5.0), {"x_px": 0.3, "y_px": -0.4, "settling_s": 5.0}),
        (LineSyncHum(0.03, 50.0), {"frequency_hz": 50.0}),
        (WrongRowTime(0.4), {"row_time_error": 0.4}),
    ],
)
def test_what_one_run_takes_for_distortion_moves_with_the_scan(effect: Effect, values: dict[str, float]) -> None:
    found = decided(42, effect)
    assert found.outcome is Outcome.IDENTIFIED
    assert found.effect is not None
    assert found.effect.name == effect.name
    assert found.evidence[0][0] == effect.name
    for name, true in values.items():
        value, sigma = values_and_sigmas(found)[name]
        assert abs(value - true) < 3.0 * sigma, f"{name}: {value} +- {sigma}, hidden {true}"
        assert sigma < 0.3 * abs(true)


def test_a_scan_bound_distortion_without_a_model_is_unknown() -> None:
    found = compare_runs((run(41), run(1043, scan=HALF)))
    assert found.outcome is Outcome.UNKNOWN
    assert found.separate_log_odds > 100.0


def test_two_runs_with_equal_scans_decide_nothing() -> None:
    with pytest.raises(IllPosed, match="equal scan times"):
        compare_runs((run(41), run(1044, bent_like=41)))


def test_runs_on_other_points_are_refused() -> None:
    with pytest.raises(IllPosed, match="different grids or frame sizes"):
        compare_runs((run(41), run(1045, (), HALF, 41, Grid(101, 101, 60, 12, 10, 43))))


def test_one_run_joined_with_nothing_is_that_run() -> None:
    alone = run(41)
    best = HyperparameterGrid(alone.design, alone.whitened_residual, (alone.best,))
    joined = join_runs([alone])
    scene = alone.design.observation.geometry
    for family in (TWO_RUN_EFFECT_CLASSES[1], EFFECT_CLASSES[1]):
        law = family.basis_field(scene, next(iter(family.grid(scene))))
        assert law is not None
        item, other = joined.projected([law]), project(best, law.field_px)
        assert item.values == pytest.approx(other.values, rel=1e-6, abs=1e-9)
        assert np.abs(item.gradient) == pytest.approx(np.abs(other.gradient), rel=1e-6, abs=1e-6)


def test_a_law_is_what_the_points_and_subsets_of_a_block_show() -> None:
    """Lost points among them: with the middles of blocks, and frame 0's for all maps, 8 % were left."""
    conditions = Conditions(47, tension=0, subset_px=FINE.subset_px)
    without, with_effects = (observed(conditions, effects, FINE, QUICK) for effects in ((), (FrameStartSettling(0.3, -0.4, 5.0),)))
    family = next(item for item in TWO_RUN_EFFECT_CLASSES if item.name == "frame_start_settling")
    like = family.basis_field(without.geometry, {"settling_s": 5.0})
    assert like is not None
    law = relative_to_reference(family, sample_within_blocks(without), {"settling_s": 5.0}, like)
    assert law is not None
    moved = with_effects.disparity_px - without.disparity_px
    residual = moved - law.field_px @ [0.3, -0.4]
    assert moved.std() > 2e-3
    assert residual.std() < 0.015 * moved.std()


def test_a_dictionary_holds_no_name_twice() -> None:
    assert len({item.name for item in (*EFFECT_CLASSES, *TWO_RUN_EFFECT_CLASSES)}) == len(EFFECT_CLASSES) + len(TWO_RUN_EFFECT_CLASSES) - 1
    assert {item.group for item in TWO_RUN_EFFECT_CLASSES} == {"G3", "G4"}
