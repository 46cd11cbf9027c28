"""What the load cell does by itself, beside the strain that the estimate of a whole experiment gives."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from blind.experiment import AREA_MM2, YOUNGS_GPA, Conditions, poses
from blind.observing import observed
from numexp.world import start_s

from semlive.data.diagnosis import Diagnosis, Outcome
from semlive.data.grid import Grid
from semlive.diagnose.load_channel import readings_of, with_loads
from semlive.diagnose.observation import Observation, StepFacts
from semlive_simulators.effects.load_cell_drift import LoadCellDrift
from semlive_simulators.effects.load_cell_zero import LoadCellZero

GRID = Grid(101, 101, 15, 50, 40, 43)
CONDITIONS = Conditions(509)
NOTHING = Diagnosis(Outcome.NONE, (), (), None, None, None, (), 0.01)


@pytest.fixture(scope="module")
def seen() -> Observation:
    return observed(CONDITIONS, (), GRID)


def steps(effect: LoadCellDrift | LoadCellZero | None) -> list[StepFacts]:
    rng = np.random.default_rng(1)
    found = []
    for one in poses(CONDITIONS):
        load_n = one.load_n if effect is None else effect.load_reading_n(one.load_n, start_s(2 * one.pair), one.motion)
        read_n = load_n + 0.1 * rng.standard_normal(2)
        found.append(StepFacts(one.pair, one.phase, (float(read_n[0]), float(read_n[1])), one.commanded_px))
    return found


def test_a_cell_that_reads_what_there_is_has_no_effect(seen: Observation) -> None:
    read = readings_of(seen, steps(None), "y")
    found = with_loads(NOTHING, read)
    assert found.outcome is Outcome.NONE
    loaded = read.loaded
    off = read.strain[loaded] - read.load_n[loaded] / (YOUNGS_GPA * 1e3 * AREA_MM2)
    assert np.sqrt(np.mean(off**2)) < 3e-5
    assert 1e-6 < np.sqrt(np.diag(read.strain_covariance)[loaded]).max() < 3e-5


def test_what_it_does_by_itself_has_a_name(seen: Observation) -> None:
    drifting = with_loads(NOTHING, readings_of(seen, steps(LoadCellDrift(0.002)), "y"))
    assert drifting.outcome is Outcome.IDENTIFIED
    (one,) = drifting.effects[0].parameters
    assert one.value == pytest.approx(0.002, abs=3.0 * one.sigma)
    assert one.sigma < 2e-4

    zero = with_loads(NOTHING, readings_of(seen, steps(LoadCellZero(-20.0)), "y"))
    assert zero.outcome is Outcome.AMBIGUOUS
    assert zero.ambiguous == ("load_cell_zero", "preload")
    (one,) = zero.effects[0].parameters
    assert one.value == pytest.approx(-20.0, abs=3.0 * one.sigma)
