"""Uncertainty under shot noise, whose variance grows with the grey level."""

from dataclasses import replace

import numpy as np
import pytest

from semlive import dic
from semlive.dic.bands import correlation as banded
from semlive.dic.shot_noise import estimate_shot_noise

SETTINGS = dic.DicSettings(step_px=16, roi_px=(30, 30, 210, 190))
WIDTH, HEIGHT = 240, 220
DRAWS = 30  # of about 25 independent subsets, u and v: the standard deviation is known to 1.8 %
ELECTRONS_PER_GREY = 0.6


@pytest.fixture(scope="module")
def bright_spots(lab):
    """Bright spots on a dark ground: gradients lie where the noise is strong. (motion) -> grey levels."""
    density = 0.05
    speckle = lab.Speckle(WIDTH, HEIGHT, seed=3, density=density)
    speckle.spots[:, 2] = 1.0

    def render(motion):
        return 30.0 + 100.0 * (speckle.render(motion) - 128.0) / 39.0 * np.sqrt(density * np.pi)

    return render


def exposed(grey, kind, rng):
    """8 bit image with Poisson noise, or with Gaussian noise of equal variance at the mean grey level."""
    if kind == "poisson":
        noisy = rng.poisson(grey * ELECTRONS_PER_GREY) / ELECTRONS_PER_GREY
    else:
        noisy = grey + np.sqrt(grey.mean() / ELECTRONS_PER_GREY) * rng.standard_normal(grey.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shift_px", [0.0, 0.5])
@pytest.mark.parametrize("kind", ["gauss", "poisson"])
def test_sigma_is_the_scatter_of_repeated_exposures(lab, bright_spots, kind, shift_px):
    still, moved = bright_spots(lab.Affine()), bright_spots(lab.Affine(u=shift_px, v=shift_px))
    rng = np.random.default_rng(7)
    grid = dic.grid_for(SETTINGS, WIDTH, HEIGHT)
    errors, plain = [], []
    for _ in range(DRAWS):
        reference = dic.prepare(exposed(still, kind, rng), grid, SETTINGS)
        assert (reference.factors is not None) == (kind == "poisson")
        m = dic.correlate(reference, exposed(moved, kind, rng), SETTINGS, reference_frame=0, current_frame=1)
        for found_px, sigma_px in ((m.u_px, m.sigma_u_px), (m.v_px, m.sigma_v_px)):
            errors.append((found_px[m.valid] - shift_px) / sigma_px[m.valid])
        if reference.factors is not None:
            plain.append(1.0 / np.sqrt(reference.factors.u.mean()))
        assert m.valid.mean() > 0.97
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) == pytest.approx(1.0, abs=0.055)
    if kind == "poisson":
        assert np.mean(plain) < 0.92  # what sigma would be without the dependence on the grey level


def test_noise_model_is_measured_on_one_frame(lab, scene):
    rng = np.random.default_rng(3)
    grey = scene()
    for noise, slope in ((6.0, 0.0), (3.0, 0.4), (0.0, 1.0)):
        noisy = grey + np.sqrt(noise**2 + slope * np.maximum(grey, 0.0)) * rng.standard_normal(grey.shape)
        found = estimate_shot_noise((noisy - noisy.mean()).astype(np.float32))
        if not slope:
            assert found is None
        else:
            assert found is not None
            assert found.slope == pytest.approx(slope, rel=0.15)
            assert found.variance == pytest.approx(noise**2 + slope * grey.mean(), rel=0.06)
    assert estimate_shot_noise(np.zeros((200, 200), np.float32)) is None
    assert estimate_shot_noise(np.zeros((10, 200), np.float32)) is None


def test_quality_predicts_the_noise_of_a_pair(lab, bright_spots):
    rng = np.random.default_rng(5)
    first, second = (exposed(bright_spots(lab.Affine()), "poisson", rng) for _ in range(2))
    grid = dic.grid_for(SETTINGS, WIDTH, HEIGHT)
    q, m = dic.quality(first, grid, SETTINGS), dic.match(first, second, grid, SETTINGS)
    assert np.sqrt(np.mean(q.sigma_u_px**2)) == pytest.approx(np.sqrt(np.mean(m.sigma_u_px[m.valid] ** 2)), rel=0.06)


def test_bands_give_the_same_bytes(lab, bright_spots):
    rng = np.random.default_rng(5)
    first, second = (exposed(bright_spots(lab.Affine()), "poisson", rng) for _ in range(2))
    settings = replace(SETTINGS, step_px=8)
    grid = dic.grid_for(settings, WIDTH, HEIGHT)
    complete = dic.match(first, second, grid, settings)
    tiled = banded.correlate_tiled(first, second, grid, settings, band_points=8 * grid.nx)
    for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "status", "covariance_px2"):
        assert getattr(complete, name).tobytes() == getattr(tiled, name).tobytes(), name
