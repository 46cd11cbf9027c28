"""Points whose place in the current frame is not there: beyond its edge, or covered; and saturated pixels."""

import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings

SETTINGS = DicSettings(subset_px=31, step_px=9, roi_px=None)


@pytest.mark.parametrize(("u", "v"), [(24.3, 0.0), (-18.6, 0.0), (0.4, 21.7), (-9.2, -14.4)])
def test_points_that_leave_the_frame_are_outside_and_the_others_are_measured(lab, scene, u, v):
    first, second = lab.expose(scene(), 3.0, 1), lab.expose(scene(lab.Affine(u=u, v=v)), 3.0, 2)
    m = dic.match(first, second, settings=SETTINGS)
    x, y = m.grid.mesh()
    half = SETTINGS.subset_px // 2
    distance = np.minimum.reduce([x + u - half, 299 - (x + u + half), y + v - half, 259 - (y + v + half)])
    # noise, which turns and stretches a subset, moves its corners by 0.2 px
    assert np.all(m.status[distance < -0.6] == PoiStatus.OUTSIDE_IMAGE)
    assert m.valid[distance > 0.6].all()
    assert np.all(np.isin(m.status, [PoiStatus.CONVERGED, PoiStatus.OUTSIDE_IMAGE]))
    assert np.max(np.abs(m.u_px - u)[m.valid]) < 0.1


def test_points_covered_in_the_current_frame_are_rejected(lab, scene):
    second = lab.expose(scene(lab.Affine(u=3.4, v=-1.2)), 3.0, 2)
    second[90:180, 100:210] = 0
    m = dic.match(lab.expose(scene(), 3.0, 1), second, settings=SETTINGS)
    x, y = m.grid.mesh()
    # subsets inside the covered area have no valid pixel, subsets outside of it keep all of theirs
    inside = (np.abs(x + 3.4 - 154.5) < 55 - 16) & (np.abs(y - 1.2 - 134.5) < 45 - 16)
    uncovered = (np.abs(x + 3.4 - 154.5) > 55 + 17) | (np.abs(y - 1.2 - 134.5) > 45 + 17)
    assert not m.valid[inside].any()
    assert np.isin(m.status[uncovered], [PoiStatus.CONVERGED, PoiStatus.OUTSIDE_IMAGE]).all()
    assert np.max(np.abs(m.u_px - 3.4)[m.valid]) < 0.5


def test_saturation_in_both_frames_costs_no_bias(lab, scene):
    """With 10 % of the pixels at 0 or 255 the bias is what it is without, so that they are used like others."""
    motion = lab.Affine(u=0.4, v=-0.4, ux=1e-3, xc=150, yc=130)
    maps = []
    for gain in (1.0, 2.0):
        first, second = (lab.expose(128.0 + gain * (image - 128.0), 2.0, k) for k, image in enumerate((scene(), scene(motion))))
        maps.append(dic.match(first, second, settings=SETTINGS))
    assert 0.08 < np.mean((first == 0) | (first == 255)) < 0.13
    m = maps[1]
    inside = np.minimum.reduce([m.grid.mesh()[0] - 18, 281 - m.grid.mesh()[0], m.grid.mesh()[1] - 18, 241 - m.grid.mesh()[1]]) > 0
    assert m.valid[inside].all()
    u, v = motion.at(*m.grid.mesh())
    sd = np.std((m.u_px - u)[m.valid])
    assert abs(np.mean((m.u_px - u)[m.valid])) < 1.5e-3
    assert abs(np.mean((m.v_px - v)[m.valid])) < 1.5e-3
    assert sd < 1.3 * np.mean(m.sigma_u_px[m.valid])
    assert np.mean(m.sigma_u_px[m.valid]) < 0.7 * np.mean(maps[0].sigma_u_px[maps[0].valid])  # more contrast is worth more


def test_saturation_in_one_frame_alone_is_no_reason_to_refuse(lab):
    speckle = lab.Speckle(400, 360, seed=11)
    second = 158.0 + 0.5 * (speckle.render(lab.Affine(u=0.3, v=0.3)) - 128.0)
    settings = DicSettings(subset_px=31, step_px=8, roi_px=(60, 60, 340, 300))
    m = dic.match(lab.expose(speckle.render(), 1.5, 1), lab.expose(second, 1.5, 2), settings=settings)
    assert m.valid.mean() > 0.99
    assert np.max(np.abs(m.u_px - 0.3)[m.valid]) < 0.08


def test_a_single_line_of_points_is_as_good_as_a_map(lab):
    speckle = lab.Speckle(400, 60, seed=3)
    first = lab.expose(speckle.render(), 3.0, 1)
    second = lab.expose(speckle.render(lab.Affine(u=0.4, v=0.2, ux=5e-3, vx=0.05, xc=200)), 3.0, 2)
    m = dic.match(first, second, settings=DicSettings(subset_px=15, step_px=1, roi_px=(30, 30, 370, 30)))
    assert m.status.shape == (1, 341)
    assert m.valid.mean() > 0.99
