"""Cracks in patterns in which the global method measures: it refuses the points whose displacement its smooth field bridges."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import PoiStatus

WIDTH, HEIGHT, CRACK_X = 256, 208, 128
SHIFT = (2.4, -1.3)
NOISE_GREY = 5.0


@lru_cache
def maps(spot_px, contrast_grey, opening_px, method="global"):
    """Map of a pair whose right half slides along a vertical line, and (ny, nx) the error of its points."""
    rng = np.random.default_rng(7)
    pattern = cv2.GaussianBlur(rng.standard_normal((HEIGHT + 40, WIDTH + 40)), (0, 0), spot_px)
    pattern = (contrast_grey / pattern.std() * pattern).astype(np.float32)
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))

    def frame(u, v):
        grey = cv2.remap(pattern, (x - u + 20).astype(np.float32), (y - v + 20).astype(np.float32), cv2.INTER_CUBIC)
        return np.clip(np.rint(128.0 + grey + NOISE_GREY * rng.standard_normal(grey.shape)), 0, 255).astype(np.uint8)

    slide = np.where(x - SHIFT[0] > CRACK_X, opening_px, 0.0)
    first, second = frame(0.0, 0.0), frame(SHIFT[0], SHIFT[1] + slide)
    m = dic.match(first, second, settings=dic.DicSettings(subset_px=41, step_px=8, roi_px=None, method=method))
    at_x, _ = m.grid.mesh()
    v = SHIFT[1] + np.where(at_x > CRACK_X, opening_px, 0.0)
    return m, np.hypot(m.u_px - SHIFT[0], m.v_px - v)


def wrong(m, error):
    return m.valid & (error > np.maximum(0.5, 6.0 * np.maximum(m.sigma_u_px, m.sigma_v_px)))


@pytest.mark.parametrize(("spot_px", "contrast_grey"), [(4.0, 39.0), (2.0, 8.0)])
def test_only_points_at_a_crack_are_refused(spot_px, contrast_grey):
    m, error = maps(spot_px, contrast_grey, 2.0)
    assert not wrong(m, error).any()
    at_x, _ = m.grid.mesh()
    near, far = np.abs(at_x - CRACK_X) < 8, np.abs(at_x - CRACK_X) > 60
    assert np.mean(m.status[near & (m.status != PoiStatus.OUTSIDE_IMAGE)] == PoiStatus.INCONSISTENT) > 0.9
    assert m.valid[far & (m.status != PoiStatus.OUTSIDE_IMAGE)].mean() > 0.95


def test_a_smooth_displacement_has_no_discontinuity():
    m, error = maps(4.0, 39.0, 0.0)
    assert np.all(m.status[m.status != PoiStatus.OUTSIDE_IMAGE] == PoiStatus.CONVERGED)
    assert error[m.valid].max() < 0.3


def test_auto_keeps_no_wrong_point_at_a_crack():
    m, error = maps(4.0, 39.0, 2.0, "auto")
    assert not wrong(m, error).any()
    assert m.valid.mean() > 0.5
