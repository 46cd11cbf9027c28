"""A turned scan separates its axes from those of the stage; another magnification shows the ratio of the pixel sizes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from semlive.data.drift import PairMotion
from semlive.qualify.protocol import STEPS
from semlive.qualify.setups import SetupMeasurement, scan_figures
from semlive.qualify.values import Conditions, Protocol, Qualification, ScanSetup

Array = NDArray[np.float64]
ASPECT, SHEAR_MRAD = 1.012, 6.0
AXES = np.array([[np.sqrt(ASPECT), 0.5e-3 * SHEAR_MRAD], [0.5e-3 * SHEAR_MRAD, 1.0 / np.sqrt(ASPECT)]])
STAGE = np.array([[1.01, 0.02], [-0.004, 0.993]])
FOUND = Qualification(
    1, Conditions("a", 0, 18, 9, 512, 442, 1e-5, 1e-2, 5.0, 100.0, "fei", True), (), (), (), (), "", "",
    Protocol(0.0, None, 1.0, 31, 10, 5, ((0.0, 0.0),), 1.0, 1.0),
)  # fmt: skip


def measured(setup: ScanSetup, turn_deg: float, scale: float, seed: int) -> SetupMeasurement:
    """Shifts of the image by a cross of stage positions, with errors of the stage of 0.02 px."""
    turn = np.radians(turn_deg)
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    commands = 12.0 * np.array(STEPS, dtype=np.float64)
    noise = 0.02 * np.random.default_rng(seed).standard_normal((len(commands), 2))
    shifts = commands @ (scale * AXES @ turned @ STAGE).T + noise
    zero = np.zeros((2, 2))
    motions = [PairMotion(pair, shift, np.full(2, 0.02), zero, zero) for pair, shift in enumerate(shifts)]
    return SetupMeasurement(setup, [(float(x), float(y)) for x, y in commands], motions, FOUND)


MAIN = ScanSetup(100.0, 0.0, 1e-5)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_axes_of_a_turned_scan_are_found_without_those_of_the_stage(sense: float) -> None:
    inside, width = list[bool](), 0.0
    for seed in range(0, 60, 2):
        other = measured(ScanSetup(100.0, 90.0, 1e-5), sense * 90.5, 1.0, seed + 1)
        figures = {item.name: item for item in scan_figures(measured(MAIN, 0.0, 1.0, seed), other)}
        true = {"scan_turn_error": sense * 0.5, "pixel_size_ratio": 1.0, "scan_aspect": ASPECT, "scan_shear": SHEAR_MRAD}
        inside += [figures[name].low <= value <= figures[name].high for name, value in true.items()]
        width = max(width, figures["scan_aspect"].high - figures["scan_aspect"].low)
    assert np.mean(inside) > 0.88
    assert width < 0.01


def test_another_magnification_shows_an_error_of_the_pixel_size() -> None:
    figures = {item.name: item for item in scan_figures(measured(MAIN, 0.0, 1.0, 1), measured(ScanSetup(50.0, 0.0, 1e-5), 0.3, 1.02, 2))}
    assert figures["pixel_size_ratio"].value == pytest.approx(1.0 / 1.02, abs=2e-3)
    assert figures["scan_turn_error"].value == pytest.approx(0.3, abs=0.2)
    assert "scan_aspect" not in figures


def test_setups_differ_by_pixel_size_rotation_and_dwell() -> None:
    assert MAIN.is_same(ScanSetup(100.5, 359.8, 1e-5))
    for other in (ScanSetup(50.0, 0.0, 1e-5), ScanSetup(100.0, 90.0, 1e-5), ScanSetup(100.0, 0.0, 2e-5)):
        assert not MAIN.is_same(other)
