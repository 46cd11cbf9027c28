"""Displacement noise and its prediction, from repeated draws of image noise."""

import numpy as np
import pytest

from semlive import dic
from semlive.data.settings import DicSettings

SETTINGS = DicSettings(step_px=16, roi_px=(40, 40, 260, 220))
DRAWS = 40  # of about 20 independent subsets: the standard deviation is known to 2.5 %


def repeated(lab, scene, motion, noise):
    grid = dic.grid_for(SETTINGS, 300, 260)
    maps = []
    for draw in range(DRAWS):
        reference = dic.prepare(lab.expose(scene(), noise, 2 * draw), grid, SETTINGS)
        current = lab.expose(scene(motion), noise, 2 * draw + 1)
        maps.append(dic.correlate(reference, current, SETTINGS, reference_frame=0, current_frame=1))
    assert all(m.valid.all() for m in maps)
    return maps


@pytest.mark.parametrize(
    ("noise", "u", "v", "strain"), [(2.0, 0.0, 0.0, 0.0), (7.0, 0.0, 0.0, 0.0), (7.0, 0.5, 0.5, 0.0), (7.0, 0.3, -0.2, 3e-3)]
)
def test_noise_is_at_the_floor_and_predicted_within_ten_percent(lab, scene, noise, u, v, strain):
    motion = lab.Affine(u=u, v=v, ux=strain, vy=-0.3 * strain, xc=150, yc=130)
    maps = repeated(lab, scene, motion, noise)
    true_u, true_v = motion.at(*maps[0].grid.mesh())
    half = SETTINGS.subset_px // 2
    for errors, sigmas, axis in (
        (np.array([m.u_px - true_u for m in maps]), np.array([m.sigma_u_px for m in maps]), 1),
        (np.array([m.v_px - true_v for m in maps]), np.array([m.sigma_v_px for m in maps]), 0),
    ):
        observed = np.sqrt(np.mean(np.var(errors, axis=0, ddof=1)))
        gradient = np.gradient(scene(), axis=axis) ** 2
        x, y = (a.astype(int) for a in maps[0].grid.mesh())
        information = [gradient[j - half : j + half + 1, i - half : i + half + 1].sum() for i, j in zip(x.flat, y.flat, strict=True)]
        rounding = 1.0 / 12.0
        floor = np.sqrt(np.mean(2.0 * (noise**2 + rounding) / np.array(information)))
        predicted = np.sqrt(np.mean(sigmas**2))
        assert observed / floor < 1.1
        assert predicted / observed == pytest.approx(1.0, abs=0.1)
        # Noise itself moves nothing: 40 draws of 20 subsets know the mean to 1/28 of the noise.
        assert abs(np.mean(errors)) < 1e-3 + 4.0 * observed / np.sqrt(20 * DRAWS)


def test_noise_of_an_image_is_estimated_without_its_motion(lab, scene):
    grid = dic.grid_for(SETTINGS, 300, 260)
    for noise in (2.0, 7.0):
        reference = dic.prepare(lab.expose(scene(), noise, 5), grid, SETTINGS)
        assert reference.noise_grey == pytest.approx(noise, rel=0.15)


def test_noise_is_predicted_for_fine_speckle_too(lab):
    # Speckle of 3.3 px: Sobel returns 0.6 of its gradient, and a third of the information is beyond any smooth gradient.
    speckle = lab.Speckle(160, 140, spot_px=1.0, seed=3)
    settings = DicSettings(subset_px=31, step_px=16, roi_px=(20, 20, 140, 120))
    grid = dic.grid_for(settings, 160, 140)
    still, moved = speckle.render(), speckle.render(lab.Affine(u=0.4, v=0.5))
    maps = []
    for draw in range(DRAWS):
        reference = dic.prepare(lab.expose(still, 6.0, 2 * draw), grid, settings)
        maps.append(dic.correlate(reference, lab.expose(moved, 6.0, 2 * draw + 1), settings, reference_frame=0, current_frame=1))
    assert all(m.valid.all() for m in maps)
    for name in ("u_px", "v_px"):
        observed = np.sqrt(np.mean(np.var([getattr(m, name) for m in maps], axis=0, ddof=1)))
        predicted = np.sqrt(np.mean([getattr(m, f"sigma_{name}") ** 2 for m in maps]))
        assert predicted / observed == pytest.approx(1.0, abs=0.1), name
