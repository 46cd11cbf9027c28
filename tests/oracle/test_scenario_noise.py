"""The scenarios' detectors make the displacement noise that the paper states, seen by correlation alone."""

from __future__ import annotations

import numpy as np
import pytest
from bench_noise import noise_of_pair


def test_x200_correlates_with_25_thousandths_of_a_pixel() -> None:
    found = noise_of_pair("paper_x200", 100.0, draws=3)
    assert found.points > 200  # 238 subsets, 2 degrees of freedom each: the spread is known to 3.3 %, that of both components to 2.3 %
    assert np.hypot(found.u_px, found.v_px) / np.sqrt(2) == pytest.approx(0.025, rel=0.07)


def test_x10000_correlates_with_a_twentieth_of_a_pixel_in_its_first_pair() -> None:
    found = noise_of_pair("paper_x10000", 0.0, draws=3)
    assert found.points > 200
    assert np.hypot(found.u_px, found.v_px) / np.sqrt(2) == pytest.approx(0.05, rel=0.07)
