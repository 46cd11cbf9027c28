"""Effects that belong to each of two runs have a size, and nothing is identified that displaces nothing."""

from __future__ import annotations

from dataclasses import replace

from blind.experiment import Conditions
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import QUICK, observed
from numexp.world import SCAN

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.two_runs import TwoRunVerdict
from semlive.data.grid import Grid
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.two_runs.decide import compare_runs
from semlive_simulators.effects.interfaces import Effect

GRID = Grid(101, 101, 60, 13, 10, 43)  # a block is a point
HALF = replace(SCAN, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)


def decided(noise_px: float, bias_px: float, effects: tuple[Effect, ...] = ()) -> TwoRunVerdict:
    """Verdict on two runs of six pairs with one distortion and another dwell."""
    first = Conditions(51, calibration=6, tension=0, noise_px=noise_px, bias_px=bias_px, outliers=0.0)
    second = replace(first, seed=1051, scan=HALF, bent_like=51)
    return compare_runs([noise_scaled_baseline(observed(one, effects, GRID, QUICK)) for one in (first, second)])


def test_the_own_bias_of_the_correlation_is_not_identified() -> None:
    found = decided(1e-3, 0.0009)
    assert found.evidence[0][0] == "dic_subpixel_bias"
    assert found.evidence[0][1] > 7.0
    assert (found.outcome, found.effect) == (Outcome.NONE, None)


def test_an_identified_effect_of_each_run_has_a_size() -> None:
    size_px = 8.0 * PROTOTYPE_PX["stage_yaw"]
    found = decided(0.02, 0.0, hidden_effect("stage_yaw", size_px, 1))
    assert found.outcome in (Outcome.IDENTIFIED, Outcome.AMBIGUOUS)
    assert found.effect is not None
    assert found.effect.peak_px > 0.3 * size_px
