"""The counts of qualified microscopes: what is inside, what is named, and a truth that follows from the parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from qualify_counts import Counted, band, named
from qualify_microscopes import CHARACTERS, character_of, draw_scenario
from qualify_raster import effect_of
from qualify_still import Truth

from semlive.qualify.values import Figure
from semlive_simulators.effects.scan_timing import WrongRowTime

STRAINS = {"image_noise": 5e-4, "drift": 4.6e-4, "distortion": 1e-4, "stage": 1e-6}


@pytest.mark.parametrize(
    ("name", "result"),
    [("image_noise", "named"), ("drift", "named"), ("distortion", "missed"), ("stage", "wrong"), ("vibration", "wrong")],
)
def test_a_name_is_right_if_it_is_that_of_the_largest_source(name: str, result: str) -> None:
    assert named(name, STRAINS) == result


def test_the_uncertainty_of_the_truth_is_added_in_squares() -> None:
    figure = Figure("noise_31", "", 1.0, 0.97, 1.03, "px")
    assert [Counted(figure, Truth(1.045, sigma)).inside for sigma in (0.0, 0.01, 0.02)] == [False, False, True]


def test_the_band_is_that_of_the_binomial_distribution() -> None:
    assert band(60) == (53, 60)


@pytest.mark.parametrize("number", range(len(CHARACTERS)))
def test_a_microscope_of_each_character_is_a_scenario(number: int, tmp_path: Path) -> None:
    scenario, other = (draw_scenario(number, seed, tmp_path) for seed in (7, 8))
    assert scenario.scan.frame_time_s != other.scan.frame_time_s
    assert bool(effect_of(scenario, WrongRowTime)) == (character_of(number) == "wrong row time")
    assert np.isfinite(scenario.drift.at(np.array([100.0]))).all()
