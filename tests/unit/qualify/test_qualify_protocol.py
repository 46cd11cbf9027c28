"""The recommended protocol has the pairs that a calibration needs, and the waiting time with the smallest error of its model."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.dic import CorrelationChoice
from semlive.dic.image_quality.row_structure import RowStructure
from semlive.qualify.protocol import LOADED_PAIRS, recommend_protocol
from semlive.qualify.values import Conditions, Figure, Protocol

CHOICE = CorrelationChoice("subset", 43, 10, 0.0, 0.0, 1.0, RowStructure(0.0, 0.0), "")


def _recommended(frame_s: float, noise_px: float, decay_s: float) -> Protocol:
    values = {"noise_43": noise_px, "drift_in_frame": 1.0, "drift_rate": 0.002, "drift_decay": decay_s, "drift_rate_first": 0.042}
    values["drift_rate_final"] = 0.002
    figures = {name: Figure(name, "", value, value, value, "") for name, value in values.items()}
    conditions = Conditions("", 0, 26, 13, 1024, 884, frame_s / 905_216, frame_s / 884, frame_s, 0.0, "", True)
    return recommend_protocol(conditions, figures, CHOICE)


def test_a_calibration_shifts_along_both_axes() -> None:
    shifts = np.array(_recommended(27.0, 0.02, 1000.0).shifts_px)
    assert len(shifts) == 3
    assert np.linalg.matrix_rank(shifts) == 2
    assert np.abs(shifts).max() == 27.0


def test_a_drift_that_the_spline_follows_needs_no_wait() -> None:
    found = _recommended(27.0, 0.02, 300.0)
    assert (found.warm_up_s, found.max_rate_px_s) == (0.0, None)


def test_the_waiting_time_has_the_smallest_error() -> None:
    frame_s, noise_px, decay_s = 400.0, 0.02, 150.0
    found = _recommended(frame_s, noise_px, decay_s)
    scans_s = 2.0 * found.dwell_factor * frame_s * (len(found.shifts_px) + LOADED_PAIRS)
    # A cubic spline with three knots in a frame has an error of 5/384 of the fourth derivative.
    error_px = 5.0 / 384.0 * 0.04 / decay_s**3 * (found.dwell_factor * frame_s / 3.0) ** 4
    wait_s = np.linspace(0.0, 0.5 * scans_s, 5001)
    variance = noise_px**2 / found.dwell_factor * scans_s / (scans_s - wait_s) + error_px**2 * np.exp(-2.0 * wait_s / decay_s)
    assert 0.0 < found.warm_up_s < 0.5 * scans_s
    at_wait = float(np.interp(found.warm_up_s, wait_s, variance))
    assert at_wait < 1.02 * variance.min() < variance[0]
    assert found.max_rate_px_s == pytest.approx(1.3 * (0.002 + 0.04 * np.exp(-found.warm_up_s / decay_s)))
