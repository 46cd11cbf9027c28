"""Signs of drift, distortion, displacement and strain, on fields written by hand."""

from __future__ import annotations

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive import mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction, FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.model import DistortionSpline, DriftSpline, UniformSpline, scan_address

GRID = Grid(101, 101, 25, 31, 25, 43)
WIDTH_PX, HEIGHT_PX, FRAME_S = 1024, 884, 94.67


def when(frame: int, start_s: float) -> FrameTime:
    def from_config(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    return FrameTime(
        frame, start_s, ScanTiming(from_config(1e-4), from_config(FRAME_S / HEIGHT_PX), from_config(FRAME_S), Sourced(1, Provenance.CONFIG))
    )


def given(reference: int, current: int, u_px: np.ndarray | float, v_px: np.ndarray | float) -> DisparityMap:
    item = np.ones(GRID.shape)
    return DisparityMap(reference, current, GRID, u_px * item, v_px * item, 0.01 * item, 0.01 * item, item, np.zeros(GRID.shape, np.uint8))


@pytest.mark.parametrize(("rate_x_px_s", "rate_y_px_s"), [(1e-3, 0.0), (0.0, 1e-3), (-2e-3, 5e-4)])
def test_positive_drift_moves_features_towards_positive_x_and_y(rate_x_px_s: float, rate_y_px_s: float) -> None:
    """With a constant rate w, the second frame shows a feature w (t_b - t_a) further, and t_b - t_a is one frame time, nearly."""
    elapsed_s = FRAME_S / (1 - rate_y_px_s * FRAME_S / HEIGHT_PX - rate_x_px_s * 1e-4)
    state = estimating.init(EstimateSettings(), GRID, WIDTH_PX, HEIGHT_PX)
    pair = given(0, 1, rate_x_px_s * elapsed_s, rate_y_px_s * elapsed_s)
    state = estimating.update(state, 0, Phase.CALIBRATION, (when(0, 0.0), when(1, FRAME_S)), (pair,))
    solution = estimating.solve(state)
    found = estimating.to_estimate(solution, 3)
    np.testing.assert_allclose(estimating.current_drift_rate(solution), (rate_x_px_s, rate_y_px_s), atol=2e-6)
    expected = found.drift.time_s[:, None] * np.array([rate_x_px_s, rate_y_px_s])
    np.testing.assert_allclose(found.drift.drift_px, expected, atol=2e-4)
    assert found.drift.revision == 3
    corrected = mechanics.displacement(pair, estimating.correction(solution, pair))
    assert np.abs(corrected.u_px).max() < 1e-3
    assert np.abs(corrected.v_px).max() < 1e-3


def test_drift_along_y_alone_looks_like_strain() -> None:
    """e_yy = v_y t_R (paper, and algorithms' hand formula): a feature lower in the frame is written later."""
    rate_px_s = 1e-3
    drift = DriftSpline(UniformSpline(0.0, FRAME_S, 3))
    parameters = np.zeros(drift.size)
    parameters[1::2] = rate_px_s * FRAME_S * (np.arange(drift.size // 2) - 1)
    x, y = (item.ravel() for item in GRID.mesh())
    p0 = np.column_stack((x, y))
    observed = scan_address((drift,), parameters, when(0, 0.0), p0, np.zeros(2))
    slope = np.polyfit(y, observed[:, 1] - y, 1)[0]
    assert slope == pytest.approx(rate_px_s * FRAME_S / HEIGHT_PX, rel=1e-3)


def test_distortion_is_added_to_the_ideal_position() -> None:
    distortion = DistortionSpline.covering(WIDTH_PX, HEIGHT_PX, 100.0)
    parameters = np.zeros(distortion.size)
    parameters[0::2], parameters[1::2] = 0.5, -0.25
    observed = scan_address((distortion,), parameters, when(0, 0.0), np.array([[300.0, 400.0]]), np.zeros(2))
    np.testing.assert_allclose(observed, [[300.5, 399.75]], atol=1e-12)


def test_strain_is_positive_in_tension_and_its_shear_is_the_tensors() -> None:
    x, y = GRID.mesh()
    u, v = -1e-3 * x + 4e-4 * y + 5, 2e-4 * x + 3e-3 * y - 7
    moved = mechanics.displacement(given(0, 4, u, v), Correction(4, np.zeros(GRID.shape), np.zeros(GRID.shape)))
    field = mechanics.strain(moved, 3)
    printed = mechanics.summary(moved, field)
    assert field.valid.all()
    for item in (field, printed.mean):
        np.testing.assert_allclose(item.exx, -1e-3, atol=1e-12)
        np.testing.assert_allclose(item.eyy, 3e-3, atol=1e-12)
        np.testing.assert_allclose(item.exy, 3e-4, atol=1e-12)
    assert printed.vsg_px == 2 * 25 + 43


def test_displacement_is_disparity_minus_correction() -> None:
    moved = mechanics.displacement(given(0, 2, 3.0, -1.0), Correction(2, np.full(GRID.shape, 0.5), np.full(GRID.shape, 0.25)))
    assert np.all(moved.u_px == 2.5)
    assert np.all(moved.v_px == -1.25)
