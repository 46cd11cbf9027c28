"""The global method: rendered rasters with known displacement, real rasters, and refusal."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings
from semlive.dic.bands import global_tiles
from semlive.dic.global_method import block_tridiagonal
from semlive.dic.global_method.coarse import find_blocks
from semlive.formats.log.maps import decode_map, encode_map

SIZE = 192
BLOBS = 260
SETTINGS = DicSettings(subset_px=31, step_px=12, roi_px=None)


def displacement(x, y):
    return 2.3 + 0.010 * y + 0.4 * np.sin(y / 60.0), -3.6 - 0.006 * x + 0.005 * y


def texture(x, y, seed):
    """Smooth grains of 5 to 9 px at random places, at any coordinates."""
    rng = np.random.default_rng(seed)
    out = np.zeros_like(x)
    for cx, cy, size, height in zip(
        *rng.uniform(-20, SIZE + 20, (2, BLOBS)), rng.uniform(5, 9, BLOBS), rng.normal(0, 1, BLOBS), strict=True
    ):
        out += height * np.exp(-0.5 * ((x - cx) ** 2 + (y - cy) ** 2) / size**2)
    return out


def raster(seed, *, moved, exposure, jump_px=0.4, offset=1500.0, gain=0.05, noise=250.0):
    """A raster frame: each row has a jump along x, an offset and a gain of its own."""
    rng = np.random.default_rng(exposure)
    x, y = np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float))
    rows = np.ones((SIZE, 1))
    x = x - jump_px * rng.standard_normal((SIZE, 1))
    if moved:  # the material point at a place of the current frame, by fixed-point iteration
        at_x, at_y = x, y
        for _ in range(20):
            u, v = displacement(at_x, at_y)
            at_x, at_y = x - u, y - v
        x, y = at_x, at_y
    grey = 30000.0 + 4000.0 * texture(x, y, seed) * (rows + gain * rng.standard_normal((SIZE, 1)))
    grey = grey + offset * rng.standard_normal((SIZE, 1)) + noise * rng.standard_normal((SIZE, SIZE))
    return np.clip(np.rint(grey), 0, 65535).astype(np.uint16)


@pytest.fixture(scope="module")
def rendered():
    return dic.match(raster(1, moved=False, exposure=1), raster(1, moved=True, exposure=2), settings=SETTINGS)


def test_auto_measures_a_raster_with_row_errors_by_the_global_method(rendered):
    assert rendered.method == "global"
    assert rendered.valid.mean() >= 0.9
    u, v = displacement(*rendered.grid.mesh())
    error = np.stack([rendered.u_px - u, rendered.v_px - v])[:, rendered.valid]
    assert np.abs(error).max() < 0.5
    assert np.abs(np.median(error, axis=1)).max() < 0.1


def test_stated_uncertainty_covers_the_error(rendered):
    u, v = displacement(*rendered.grid.mesh())
    valid = rendered.valid
    z = np.stack([(rendered.u_px - u) / np.maximum(rendered.sigma_u_px, 1e-9), (rendered.v_px - v) / np.maximum(rendered.sigma_v_px, 1e-9)])
    assert np.mean(np.abs(z[:, valid]) < 3.0) >= 0.95
    assert rendered.sigma_u_px[valid].max() < 0.5


def test_neighbour_share_is_a_fraction_and_survives_the_log(rendered):
    share = rendered.neighbour_share
    assert share is not None
    assert share.min() >= 0.0
    assert share.max() <= 1.0
    assert share[rendered.valid].max() > 0.0
    decoded = decode_map(encode_map(rendered))
    assert decoded.method == "global"
    np.testing.assert_array_equal(decoded.neighbour_share, share)
    np.testing.assert_array_equal(decoded.status, rendered.status)


def test_a_frame_beyond_the_limit_is_measured_in_tiles(rendered, monkeypatch):
    monkeypatch.setattr(global_tiles, "TILE_PX", 96)
    monkeypatch.setattr(global_tiles, "OVERLAP_PX", 48)
    mask = np.ones((SIZE, SIZE), dtype=bool)
    mask[:, :40] = False
    frames = raster(1, moved=False, exposure=1), raster(1, moved=True, exposure=2)
    tiled = dic.correlate_tiled(*frames, rendered.grid, SETTINGS, mask=mask)
    assert tiled.method == "global"
    masked = tiled.status == PoiStatus.MASKED
    assert masked[:, 0].all()
    assert tiled.valid[~masked].mean() >= 0.8
    both = tiled.valid & rendered.valid
    u, v = displacement(*rendered.grid.mesh())
    assert np.abs(tiled.u_px - u)[both].max() < 0.5
    assert np.abs(tiled.v_px - v)[both].max() < 0.5


def test_incremental_correlation_uses_it_where_subsets_find_too_few_points(rendered):
    track = dic.begin(raster(1, moved=False, exposure=1), rendered.grid, SETTINGS)
    first, _ = dic.advance(track, raster(1, moved=True, exposure=2), SETTINGS, 1)
    assert first.method == "global"
    np.testing.assert_array_equal(first.u_px, rendered.u_px)


@pytest.mark.parametrize("method", ["auto", "global"])
def test_unrelated_frames_are_refused(method):
    settings = DicSettings(subset_px=31, step_px=12, roi_px=None, method=method)
    m = dic.match(raster(1, moved=False, exposure=1), raster(2, moved=False, exposure=2), settings=settings)
    assert not m.valid.any()
    assert m.status.max() > PoiStatus.CONVERGED


@pytest.mark.parametrize("kind", ["one grey level", "white", "coarse"])
def test_noise_without_a_common_pattern_is_refused(kind):
    """Without the neighbours 28 of 100 pairs of coarse noise passed."""
    shape = (221, 256)
    for seed in range(1000, 1012):
        random = np.random.default_rng(seed)
        frames = []
        for _ in range(2):
            noise = random.normal(size=shape)
            if kind == "coarse":
                noise = gaussian_filter(noise, 4.0) * 12.0 + 0.6 * random.normal(size=shape)
            frames.append(np.floor(128.0 + (0.2 if kind == "one grey level" else 5.0) * noise).astype(np.float32))
        blocks = find_blocks(*frames)
        assert blocks.ambiguous or not blocks.sufficient


def test_a_regular_lattice_is_ambiguous():
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    lattice = (128 + 60 * np.sin(2 * np.pi * x / 12) * np.sin(2 * np.pi * y / 12)).astype(np.uint8)
    m = dic.match(lattice, np.roll(lattice, 2, axis=1), settings=DicSettings(subset_px=31, step_px=12, roi_px=None, method="global"))
    assert set(np.unique(m.status)) == {PoiStatus.AMBIGUOUS}


def test_method_does_not_change_maps_of_good_speckle():
    rng = np.random.default_rng(3)
    speckle = cv2.GaussianBlur(rng.standard_normal((160, 160)), (0, 0), 2.0)
    first = np.clip(128 + 200 * speckle, 0, 255).astype(np.uint8)
    second = np.roll(first, (2, -3), axis=(0, 1))
    auto, subset = (dic.match(first, second, settings=DicSettings(31, 10, None, method=method)) for method in ("auto", "subset"))
    assert auto.neighbour_share is None
    for name in ("u_px", "v_px", "sigma_u_px", "zncc", "status"):
        np.testing.assert_array_equal(getattr(auto, name), getattr(subset, name))
    assert len(encode_map(auto)) == 40 + auto.status.size * 41


def test_settings_reject_an_unknown_method():
    with pytest.raises(ValueError, match="method must be auto, subset or global, not best"):
        DicSettings(method="best")  # type: ignore[arg-type]


def test_block_tridiagonal_solution_inverse_and_draws():
    rng = np.random.default_rng(4)
    n, m = 4, 3
    dense = np.zeros((n * m, n * m))
    for k in range(n - 1):
        part = rng.standard_normal((2 * m, 2 * m))
        dense[k * m : (k + 2) * m, k * m : (k + 2) * m] += part @ part.T
    dense += np.eye(n * m)
    diagonal = np.stack([dense[k * m : (k + 1) * m, k * m : (k + 1) * m] for k in range(n)])
    upper = np.stack([dense[k * m : (k + 1) * m, (k + 1) * m : (k + 2) * m] for k in range(n - 1)])
    factor = block_tridiagonal.factor(diagonal, upper)
    right = rng.standard_normal((n, m))
    np.testing.assert_allclose(block_tridiagonal.solve(factor, right).ravel(), np.linalg.solve(dense, right.ravel()), rtol=1e-9)
    np.testing.assert_allclose(block_tridiagonal.product(diagonal, upper, right).ravel(), dense @ right.ravel(), rtol=1e-9)
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1])
    inverse = np.linalg.inv(dense)
    own, after = block_tridiagonal.inverse_blocks(factor)
    np.testing.assert_allclose(own[1], inverse[m : 2 * m, m : 2 * m], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(after[1], inverse[m : 2 * m, 2 * m : 3 * m], rtol=1e-8, atol=1e-10)
    samples = block_tridiagonal.draws(factor, 20000).reshape(n * m, -1)
    np.testing.assert_allclose(samples @ samples.T / 20000, inverse, atol=0.03 * np.abs(inverse).max())


@pytest.mark.parametrize(
    ("first", "second", "area"),
    [("PZT_thick0004", "PZT_thick0006", 0.9), ("Cs50MA50approx_0044", "Cs50MA50approx_0045", 0.9)],
)
def test_real_raster(real_samples, first, second, area):
    images = [cv2.imread(str(real_samples / f"{name}.png"), cv2.IMREAD_UNCHANGED) for name in (first, second)]
    m = dic.match(images[0], images[1], settings=DicSettings(step_px=6, roi_px=None))
    x, y, u, v, _ = np.genfromtxt(real_samples / f"{first}__{second}.csv", delimiter=",", skip_header=1).T
    i = np.round((x - m.grid.x0_px) / m.grid.step_px).astype(int).clip(0, m.grid.nx - 1)
    j = np.round((y - m.grid.y0_px) / m.grid.step_px).astype(int).clip(0, m.grid.ny - 1)
    valid = m.valid[j, i]
    assert m.method == "global"
    assert valid.mean() >= area
    difference = np.abs(np.stack([m.u_px[j, i] - u, m.v_px[j, i] - v]))[:, valid]
    sigma = np.stack([m.sigma_u_px[j, i], m.sigma_v_px[j, i]])[:, valid]
    assert np.mean(difference <= 3.0 * sigma + 0.3) >= 0.93
