"""Every POI that cannot be measured has a status with the reason, and carries no number."""

import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings
from semlive.errors import BadInput

SETTINGS = DicSettings(step_px=8, roi_px=None, method="subset")  # the reasons of subsets; the global method has others


def assert_silent(m):
    """No number where nothing was measured, a sound one where it was."""
    lost = ~m.valid
    for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc"):
        values = getattr(m, name)
        assert np.all(values[lost] == 0.0), name
        assert np.all(np.isfinite(values)), name
    assert np.all(m.sigma_u_px[m.valid] > 0.0)


def blanked(image, level, noise, seed):
    blank = image.copy()
    area = np.s_[60:200, 80:220]
    blank[area] = level + (noise * np.random.default_rng(seed).standard_normal(blank[area].shape) if noise else 0.0)
    return blank


@pytest.mark.parametrize("noise", [0.0, 6.0])
def test_a_blank_area_of_the_reference_has_low_contrast(lab, scene, measure, noise):
    first = lab.expose(blanked(scene(), 128.0, 0.0, 0), noise, 1)
    second = lab.expose(blanked(scene(), 128.0, 0.0, 0), noise, 2)
    m = measure(first, second, SETTINGS)
    x, y = m.grid.mesh()
    blank = (x - 21 >= 80) & (x + 21 < 220) & (y - 21 >= 60) & (y + 21 < 200)
    clear = (x + 23 < 80) | (x - 23 >= 220) | (y + 23 < 60) | (y - 23 >= 200)
    clear &= (np.abs(x - 149.5) < 127) & (np.abs(y - 129.5) < 107)  # at the very edge noise pushes subsets out
    assert np.all(m.status[blank] == PoiStatus.LOW_CONTRAST)
    assert m.valid[clear].all()
    assert_silent(m)


def test_points_of_a_changed_area_are_rejected(lab, scene, measure):
    other = lab.Speckle(300, 260, seed=9).render()
    second = scene(lab.Affine(u=1.5, v=0.5))
    second = np.where((np.abs(np.arange(300) - 150) < 70) & (np.abs(np.arange(260) - 130) < 70)[:, None], other, second)
    m = measure(lab.expose(scene(), 5.0, 1), lab.expose(second, 5.0, 2), SETTINGS)
    x, y = m.grid.mesh()
    changed = (np.abs(x - 150) < 46) & (np.abs(y - 130) < 46)
    clear = (np.abs(x - 150) > 94) | (np.abs(y - 130) > 94)
    clear &= (x < 275) & (y < 235)
    assert np.all(np.isin(m.status[changed], [PoiStatus.LOW_ZNCC, PoiStatus.NOT_CONVERGED]))
    assert m.valid[clear].all()
    assert_silent(m)


def test_stripes_determine_one_direction_only_and_are_refused(measure):
    x = np.arange(300)
    stripes = 128.0 + 60.0 * np.sin(0.7 * x + 2.0 * np.sin(0.05 * x)) + np.zeros((260, 1))
    noise = np.random.default_rng(3).normal(0.0, 4.0, (2, 260, 300))
    first, second = np.round(stripes + noise).astype(np.uint8)
    m = measure(first, second, SETTINGS)
    assert np.all(m.status == PoiStatus.LOW_CONTRAST)
    assert_silent(m)


def test_unrelated_frames_give_no_first_guess(lab, scene, measure):
    other = lab.Speckle(300, 260, seed=9).render()
    m = measure(lab.expose(scene(), 5.0, 1), lab.expose(other, 5.0, 2), SETTINGS)
    assert np.all(m.status == PoiStatus.NO_SEED)
    assert_silent(m)


@pytest.mark.parametrize("level", [0, 255])
def test_a_dead_current_frame_gives_no_first_guess(lab, scene, measure, level):
    m = measure(lab.expose(scene()), np.full((260, 300), level, dtype=np.uint8), SETTINGS)
    assert np.all(m.status == PoiStatus.NO_SEED)
    assert_silent(m)


def test_a_dead_reference_has_low_contrast_everywhere(lab, scene, measure):
    m = measure(np.full((260, 300), 7, dtype=np.uint8), lab.expose(scene()), SETTINGS)
    assert np.all(m.status == PoiStatus.LOW_CONTRAST)


def test_too_few_iterations_are_not_convergence(lab, scene, measure):
    current = lab.expose(scene(lab.Affine(u=0.4, v=0.3, ux=5e-3)), 5.0, 1)
    m = measure(lab.expose(scene()), current, DicSettings(step_px=8, roi_px=(40, 40, 250, 210), max_iterations=1, method="subset"))
    assert np.all(m.status == PoiStatus.NOT_CONVERGED)
    assert_silent(m)


def test_frames_of_different_size_are_bad_input(lab, scene):
    image = lab.expose(scene())
    reference = dic.prepare(image, dic.grid_for(SETTINGS, 300, 260), SETTINGS)
    with pytest.raises(BadInput, match="frame 4 is 300 x 200 px but its reference, frame 0, is 300 x 260 px"):
        dic.correlate(reference, image[:200], SETTINGS, reference_frame=0, current_frame=4)


def test_a_grid_for_another_subset_is_bad_input(lab, scene):
    grid = dic.grid_for(DicSettings(subset_px=21, roi_px=None), 300, 260)
    with pytest.raises(BadInput, match="make a new grid"):
        dic.prepare(lab.expose(scene()), grid, SETTINGS)


def test_a_tiny_frame_is_correlated_too(lab, measure):
    speckle = lab.Speckle(60, 50)
    m = measure(lab.expose(speckle.render()), lab.expose(speckle.render(lab.Affine(u=0.6, v=1.2))), DicSettings(21, 4, (14, 14, 40, 35)))
    assert m.valid.all()
    assert abs(np.mean(m.u_px) - 0.6) < 5e-3
