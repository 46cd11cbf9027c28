"""The path of the stage, against truths made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.data.drift import PairMotion
from semlive.estimate.joint.outputs.stage_path import stage_path, stage_path_notes

CROSS_PX = np.array([(0, 0), (8, 0), (-16, 0), (24, 0), (-32, 0), (0, 8), (0, -16), (0, 24), (0, -32)], dtype=np.float64)


def turned(angle_deg: float) -> np.ndarray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s], [s, c]])


def test_the_path_of_the_stage_reports_scale_and_angle() -> None:
    """A stage whose y axis leans by 2 degrees and whose y screw is 1 % long."""
    axes = np.array([[0.8, 0.0], [0.8 * 1.01 * np.sin(np.radians(2.0)), 0.8 * 1.01 * np.cos(np.radians(2.0))]])
    rng = np.random.default_rng(3)
    shifts = 1.25 * CROSS_PX @ axes @ turned(5.0).T + rng.normal(0, 0.05, CROSS_PX.shape)
    found = stage_path(1.25 * CROSS_PX, shifts)
    assert found.scale_y / found.scale_x == pytest.approx(1.01, abs=4 * 1.4 * found.scale_sigma)
    assert found.angle_deg == pytest.approx(88.0, abs=4 * found.angle_sigma_deg)
    assert found.rotation_deg == pytest.approx(5.0, abs=0.3)
    assert found.residual_px == pytest.approx(0.05, rel=0.5)


def test_the_stage_path_is_estimated_only_where_it_is_determined() -> None:
    def motion(pair: int, shift: np.ndarray) -> PairMotion:
        return PairMotion(pair, shift, np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2)))

    commands = [(pair, (float(x), float(y))) for pair, (x, y) in enumerate(CROSS_PX)]
    motions = [motion(pair, 0.8 * shift) for pair, shift in enumerate(CROSS_PX)]
    (printed,) = stage_path_notes(commands, motions)
    assert "0.8 px/um along the stage's x" in printed.text
    assert "90.00" in printed.text
    assert stage_path_notes(commands[:5], motions) == ()
    assert stage_path_notes(commands, motions[:3]) == ()
    assert stage_path_notes([(pair, (0.0, 0.0)) for pair, _ in commands], motions) == ()
