"""Pairs whose difference is more than noise: points that two bands confirm are kept, with the uncertainty that the bands show."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.dic.outlier_rejection import PointMeasurements
from semlive.dic.second_estimate import SecondEstimates, confirm, is_doubtful

SETTINGS = dic.DicSettings(subset_px=41, step_px=8, roi_px=None)
SHIFT = (1.3, -0.6)


def coarse_surface(lab):
    """Grains of very unequal contrast, exact at any shift: (motion) -> grey levels."""
    parts = [lab.Speckle(240, 220, spot_px=spot, seed=seed) for spot, seed in ((3.0, 1), (7.0, 2))]

    def render(motion):
        fine, coarse = (part.render(motion) - 128.0 for part in parts)
        return fine, coarse

    return render


def changed(fine, coarse, seed):
    """16 bit frame: rows of unequal brightness, detail that belongs to one frame alone, little white noise."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((fine.shape[0], 1))
    own = cv2.GaussianBlur(rng.standard_normal(fine.shape), (0, 0), 4.0)
    strength = np.linspace(0.0, 1.0, fine.shape[1])
    grey = 128.0 + 0.5 * fine + 0.7 * coarse + 2.0 * rows + 12.0 * strength * own / own.std() + 0.3 * rng.standard_normal(fine.shape)
    return np.clip(np.round(200.0 * grey), 0, 65535).astype(np.uint16)


def test_points_of_a_changed_surface_are_retained_with_a_realistic_uncertainty(lab):
    render = coarse_surface(lab)
    first, second = changed(*render(lab.Affine()), 3), changed(*render(lab.Affine(u=SHIFT[0], v=SHIFT[1])), 4)
    m = dic.match(first, second, settings=SETTINGS)
    assert m.valid.mean() > 0.6
    errors = np.concatenate([(m.u_px - SHIFT[0])[m.valid] / m.sigma_u_px[m.valid], (m.v_px - SHIFT[1])[m.valid] / m.sigma_v_px[m.valid]])
    assert np.mean(np.abs(errors) < 3.0) > 0.95
    assert np.hypot(m.u_px - SHIFT[0], m.v_px - SHIFT[1])[m.valid].max() < 2.0


def measurements(shape, sigma_px=0.02):
    zero = np.zeros(shape)
    return PointMeasurements(
        zero, zero, np.zeros((*shape, 4), np.float32), zero + sigma_px, zero + sigma_px, zero, zero + 0.99, zero.astype(np.float32),
        zero.astype(np.float32), np.full(shape, PoiStatus.CONVERGED, np.uint8), np.ones(shape, np.int32), zero.astype(np.float32),
    )  # fmt: skip


def test_bands_decide_on_doubtful_points():
    grid = dic.Grid(x0_px=30, y0_px=30, step_px=10, nx=12, ny=10, subset_px=41)
    m = measurements(grid.shape)
    verdict = np.full(grid.shape, PoiStatus.CONVERGED, np.uint8)
    verdict[:, 3:6] = PoiStatus.LOW_ZNCC
    verdict[:, 6:9] = PoiStatus.INCONSISTENT
    assert is_doubtful(m, verdict, 0.0)
    verdict[:, 0] = PoiStatus.LOW_CONTRAST
    difference = np.zeros((2, *grid.shape, 2))
    difference[0, ..., 0], difference[1, ..., 0] = 0.1, -0.1
    difference[1, 5, 4] = (0.5, 0.0)  # a band contradicts a refused point
    difference[0, 5, 10] = (0.0, 0.6)  # and one that was accepted
    found = np.ones((2, *grid.shape), dtype=bool)
    found[1, 8, 5] = False
    inflated, status = confirm(m, verdict, SecondEstimates(difference, found), grid)
    assert status[5, 4] == PoiStatus.LOW_ZNCC
    assert status[8, 5] == PoiStatus.LOW_ZNCC
    assert status[5, 10] == PoiStatus.INCONSISTENT
    assert (status[:, 0] == PoiStatus.LOW_CONTRAST).all()
    expected = np.full(grid.shape, PoiStatus.CONVERGED, np.uint8)
    expected[:, 0], expected[5, 4], expected[8, 5], expected[5, 10] = 4, 2, 2, 7
    assert np.array_equal(status, expected)
    assert inflated.sigma_u_px[3, 2] == pytest.approx(np.hypot(0.02, 2.0 * 0.1))
    assert inflated.sigma_v_px[3, 2] == pytest.approx(0.02)
    isolated = np.zeros_like(found)
    isolated[:, 4, 4] = True
    assert confirm(m, verdict, SecondEstimates(difference, isolated), grid)[1][4, 4] == PoiStatus.LOW_ZNCC


def test_doubtful_points_stay_refused_where_noise_hides_edges():
    m = replace(measurements((10, 12)), contrast=np.full((10, 12), 400.0, np.float32))
    verdict = np.full((10, 12), PoiStatus.INCONSISTENT, np.uint8)
    assert is_doubtful(m, verdict, 5.0)
    assert not is_doubtful(m, verdict, 8.0)  # 19 % of the variance of the pattern


def test_bands_confirm_the_same_points(lab):
    render = coarse_surface(lab)
    first, second = changed(*render(lab.Affine()), 3), changed(*render(lab.Affine(u=SHIFT[0], v=SHIFT[1])), 4)
    one = dic.match(first, second, settings=SETTINGS)
    many = dic.correlate_tiled(first, second, one.grid, SETTINGS, band_px=240 * 260)
    for name in ("status", "u_px", "v_px"):
        assert np.array_equal(getattr(one, name), getattr(many, name)), name
    np.testing.assert_allclose(many.sigma_u_px, one.sigma_u_px, rtol=1e-3)


def test_few_refused_points_change_nothing():
    m = measurements((10, 12))
    verdict = np.full((10, 12), PoiStatus.CONVERGED, np.uint8)
    verdict[:2] = PoiStatus.INCONSISTENT
    assert not is_doubtful(m, verdict, 0.0)
    assert not is_doubtful(replace(m, status=np.full((10, 12), PoiStatus.NO_SEED, np.uint8)), verdict, 0.0)
