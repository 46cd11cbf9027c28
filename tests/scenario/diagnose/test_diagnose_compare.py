"""A measurement against simulations of it: the gap shrinks with the right effect, and not with a wrong one."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from blind.experiment import Conditions
from blind.hiding import hidden_effect
from blind.observing import QUICK, observed

from semlive.data.grid import Grid
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.simulation_comparison import compare_with_simulations
from semlive.errors import BadInput

GRID = Grid(101, 101, 45, 17, 14, 43)  # a block is a point
FINE = Grid(101, 101, 15, 50, 40, 43)  # a block is the mean of nine
MEASURED, SIMULATED = Conditions(511, calibration=5, tension=4), Conditions(512, calibration=5, tension=4, noise_px=0.015)
"""Other drift, distortion, noise and places of the stage."""
TILT = hidden_effect("tilt_with_load", 0.3, 1)


@pytest.fixture(scope="module")
def without() -> Observation:
    return observed(SIMULATED, (), GRID, QUICK)


@pytest.fixture(scope="module")
def tilted() -> Observation:
    return observed(SIMULATED, TILT, GRID, QUICK)


def test_maps_corrected_for_the_found_effect_agree(without: Observation, tilted: Observation) -> None:
    measured = observed(MEASURED, TILT, GRID, QUICK)
    found = compare_with_simulations(measured, without, tilted)
    assert found.maps.closure == pytest.approx(1.0, abs=0.15)
    assert found.maps.interval[0] > 0.6
    assert found.maps.after_px == pytest.approx(found.maps.floor_px, rel=0.1)
    assert found.sizes.ratio == pytest.approx(1.0, abs=0.35)
    assert found.confirmed
    channels = {item.channel: item for item in found.channels}
    assert list(channels) == ["x", "y", "x_smooth", "y_smooth"]
    for item in channels.values():
        assert item.after is not None
        assert abs(item.after.value - item.expected.value) < 4.0 * math.hypot(item.after.sigma, item.expected.sigma)
        assert item.expected.value == pytest.approx(1.0, abs=0.5)
    assert channels["x_smooth"].before.value > channels["x_smooth"].expected.value + 4.0 * channels["x_smooth"].expected.sigma
    other = compare_with_simulations(measured, without, observed(SIMULATED, hidden_effect("bending_misalignment", 0.3, 1), GRID, QUICK))
    assert not other.maps.is_reduced


def test_an_effect_drawn_for_every_frame_is_compared_by_its_size(without: Observation) -> None:
    measured, with_effects = (
        observed(conditions, hidden_effect("magnification_frame_instability", 0.1, seed), GRID, QUICK)
        for seed, conditions in ((1, MEASURED), (2, SIMULATED))
    )
    found = compare_with_simulations(measured, without, with_effects)
    assert not found.maps.is_reduced
    assert found.sizes.interval[0] < 1.0 < found.sizes.interval[1]
    assert found.confirmed


def test_what_the_estimate_takes_for_the_raster_is_compared_too() -> None:
    stretched = hidden_effect("magnification_drift", 0.4, 1)
    measured, with_effects = (observed(conditions, stretched, FINE, QUICK) for conditions in (MEASURED, SIMULATED))
    without = observed(SIMULATED, (), FINE, QUICK)
    assert [item.included for item in measured.solution.terms if item.name == "magnification"] == [True]

    found = compare_with_simulations(measured, without, with_effects)
    assert found.maps.closure == pytest.approx(1.0, abs=0.15)
    assert found.maps.before_px > 1.2 * found.maps.floor_px
    assert found.confirmed


def test_where_nothing_is_missing_nothing_shrinks(without: Observation, tilted: Observation) -> None:
    found = compare_with_simulations(observed(MEASURED, (), GRID, QUICK), without, tilted)
    assert found.maps.before_px == pytest.approx(found.maps.floor_px, rel=0.1)
    assert not found.confirmed


def test_runs_of_other_frames_are_refused(without: Observation) -> None:
    fewer = observed(replace(SIMULATED, tension=3), (), GRID, QUICK)
    with pytest.raises(BadInput, match=r"frame by frame: 18 frames .* 16 frames"):
        compare_with_simulations(without, fewer, without)
