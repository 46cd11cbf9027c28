"""A turned scan separates its axes from those of the stage; another magnification shows the ratio of the pixel sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from semlive.data.drift import PairMotion
from semlive.qualify.figures.setups import MAGNIFIED, TURNED, SetupMeasurement, joined, row_time_figures, scan_figures
from semlive.qualify.further import StepName, proposals
from semlive.qualify.protocol import STEPS
from semlive.qualify.values import Conditions, Figure, Protocol, Qualification, ScanSetup, Undetermined

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


def timed(height_px: int, ratio: float, pairs: int, seed: int) -> SetupMeasurement:
    """Pairs in place with a pause of 3 s, which scatters by 0.1 s, and rows that take longer than the 10 ms of the files."""
    found = replace(FOUND, conditions=replace(FOUND.conditions, height_px=height_px, frame_s=height_px * 1e-2))
    pauses_s = 3.0 + 0.1 * np.random.default_rng(seed).standard_normal(pairs)
    return SetupMeasurement(MAIN, [], [], found, tuple(height_px * 1e-2 * ratio + pauses_s))


def test_frames_with_fewer_rows_show_the_row_time_without_the_pause() -> None:
    inside = []
    for seed in range(0, 200, 2):
        (figure,) = row_time_figures(timed(442, 1.25, 13, seed), timed(221, 1.25, 3, seed + 1))
        inside.append(figure.low <= 1.25 <= figure.high)
        assert figure.high - figure.low < 0.4
    assert 0.88 < np.mean(inside) <= 1.0
    assert not row_time_figures(timed(442, 1.25, 13, 1), timed(442, 1.25, 3, 2))
    assert not row_time_figures(timed(442, 1.25, 13, 1), timed(221, 1.25, 1, 2))


def figure_of(name: str, low: float, high: float) -> Figure:
    return Figure(name, name, 0.5 * (low + high), low, high, "")


def test_further_steps_are_those_that_are_still_uncertain() -> None:
    settled = replace(FOUND, undetermined=(TURNED, MAGNIFIED), figures=(figure_of("frame_interval", 1.01, 1.012),))
    assert proposals(settled) == ()  # no pause, no settling, and no stage whose axes the scan could bend
    stage = [figure_of("stage_angle", 89.0, 89.5), figure_of("stage_scale_x", 0.99, 1.01), figure_of("stage_scale_y", 0.99, 1.01)]
    uncertain = replace(
        settled,
        figures=(figure_of("frame_interval", 1.12, 1.13), *stage),
        undetermined=(*settled.undetermined, Undetermined("row_start_law", "one dwell", "take another")),
    )
    assert [item.step.name for item in proposals(uncertain)] == list(StepName)
    slower = SetupMeasurement(replace(MAIN, dwell_s=2e-5), [], [], FOUND)
    rows = timed(221, 1.0, 3, 3)
    main = replace(timed(442, 1.0, 13, 4), found=replace(uncertain, conditions=timed(442, 1.0, 2, 4).found.conditions, undetermined=()))
    assert [item.step.name for item in proposals(joined(main, [slower, rows]))] == [StepName.TURNED]
    scattered = replace(rows, intervals_s=(2.0, 9.0, 5.0))
    (first, _) = proposals(joined(main, [slower, scattered]))
    assert first.step.name is StepName.ROWS
    assert "determine the row time to" in first.reason
