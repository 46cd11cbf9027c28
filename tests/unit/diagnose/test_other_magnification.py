"""Settling in position: what one run shows of it, and what a second run at another magnification decides."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from blind.experiment import Conditions
from blind.observing import observed
from numexp.world import SCAN

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.grid import Grid
from semlive.data.settings import EstimateSettings
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.experiments.distortion_settling import settling_of_run
from semlive.diagnose.two_runs.decide import compare_runs
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.settling import RowStartSettlingInPosition
from semlive_simulators.microscope.scan import Scan

GRID = Grid(56, 56, 60, 15, 12, 43)
COARSE = EstimateSettings(drift_knots_per_frame=0.5, distortion_knot_px=300.0)
PIXEL_UM = SCAN.pixel_size_um
OTHER = replace(SCAN, pixel_size_um=0.5 * PIXEL_UM, dwell_time_s=0.25 * SCAN.dwell_time_s, frame_time_s=0.25 * SCAN.frame_time_s)
SETTLES = (RowStartSettlingInPosition(1.0 * PIXEL_UM, 50.0 * PIXEL_UM),)
NOTHING = Diagnosis(Outcome.NONE, (), (), None, None, None, (), 0.0)


@cache
def run(seed: int, effects: tuple[Effect, ...], scan: Scan = SCAN) -> Observation:
    conditions = Conditions(seed, calibration=7, tension=0, scan=scan, bent_like=42, subset_px=GRID.subset_px)
    return observed(conditions, effects, GRID, COARSE)


def test_one_run_lists_both_laws_and_the_scan_that_separates_them() -> None:
    (found,) = settling_of_run(run(42, SETTLES), NOTHING)
    assert (found.start, found.between) == ("row", ("flyback_settling", "row_start_settling_in_position"))
    amplitude, length = found.parameters
    assert amplitude.value == pytest.approx(1.0, abs=5.0 * amplitude.sigma)
    assert length.value == pytest.approx(50.0, abs=5.0 * length.sigma)
    best = found.forecasts[0]
    assert best.kind == "other_magnification"
    assert best.log_odds > 3.0
    assert best.pixel_size != 1.0 != best.dwell
    by_factors = {(item.pixel_size, item.dwell): item for item in found.forecasts}
    for degenerate in ((0.5, 0.5), (2.0, 2.0), (0.5, 2.0), (2.0, 0.5)):  # equal laws, or equal but for the sign
        assert by_factors[degenerate].log_odds < 0.2 * best.log_odds
    assert by_factors[1.0, 0.5].true == "row_start_settling_in_position"
    assert by_factors[1.0, 0.5].log_odds == pytest.approx(0.0, abs=1e-9)
    assert "cannot separate flyback_settling from row_start_settling_in_position" in found.text


def test_a_distortion_without_settling_is_not_named() -> None:
    assert settling_of_run(run(42, ()), NOTHING) == ()


def test_a_second_run_at_another_magnification_names_the_law() -> None:
    found = compare_runs([noise_scaled_baseline(run(seed, SETTLES, scan)) for seed, scan in ((42, SCAN), (1042, OTHER))])
    assert found.outcome is Outcome.IDENTIFIED
    assert found.effect is not None
    assert (found.effect.name, found.pixel_ratio) == ("row_start_settling_in_position", 0.5)
    values = {item.name: item for item in found.effect.parameters}
    assert values["amplitude_px"].value == pytest.approx(1.0, abs=4.0 * values["amplitude_px"].sigma)
    assert values["length_um"].value == pytest.approx(50.0 * PIXEL_UM, abs=4.0 * values["length_um"].sigma)
    assert dict(found.evidence)["flyback_settling"] < dict(found.evidence)["row_start_settling_in_position"] - 3.0
