"""Masked parts of a frame: the unmasked part of a subset is measured with its own uncertainty, or the point is MASKED."""

import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings
from semlive.errors import BadInput

SETTINGS = DicSettings(step_px=12, roi_px=(36, 36, 264, 224))
MOTION = {"u": 0.4, "v": -1.3, "ux": 2e-3, "xc": 150, "yc": 130}


def correlate(first, second, mask, settings=SETTINGS):
    grid = dic.grid_for(settings, 300, 260)
    reference = dic.prepare(first, grid, settings, mask)
    return reference, dic.correlate(reference, second, settings, reference_frame=0, current_frame=1)


@pytest.fixture(scope="module")
def mask():
    allowed = np.ones((260, 300), dtype=bool)
    allowed[100:160, 120:200] = False
    allowed[:, :50] = False
    return allowed


def test_what_a_mask_hides_changes_no_byte(lab, scene, mask):
    second = lab.expose(scene(lab.Affine(**MOTION)), 3.0, 2)
    maps = []
    for seed in (3, 4):
        first = lab.expose(scene(), 3.0, 1)
        first[~mask] = np.random.default_rng(seed).integers(0, 256, int((~mask).sum()))
        maps.append(correlate(first, second, mask)[1])
    for name in ("u_px", "v_px", "sigma_u_px", "zncc", "status"):
        assert np.array_equal(getattr(maps[0], name), getattr(maps[1], name)), name


def test_subsets_around_a_mask_are_measured_with_what_they_have(lab, scene, mask):
    motion = lab.Affine(**MOTION)
    first, second = scene().copy(), scene(motion).copy()
    junk = np.random.default_rng(5).uniform(0.0, 255.0, (2, 260, 300))
    first[~mask] = junk[0][~mask]
    second[~mask] = junk[1][~mask]
    reference, m = correlate(lab.expose(first, 4.0, 1), lab.expose(second, 4.0, 2), mask)
    fraction = reference.sums.pixels / SETTINGS.subset_px**2
    assert np.array_equal(m.status == PoiStatus.MASKED, fraction < SETTINGS.min_valid_fraction)
    partly = (fraction < 0.9) & (fraction > 0.55)
    assert partly.sum() > 20
    u, _ = motion.at(*m.grid.mesh())
    # the second frame's junk came with us by 1.3 px: its rim is within some subsets
    assert np.mean(m.valid[fraction >= SETTINGS.min_valid_fraction]) > 0.97
    assert np.abs(np.mean((m.u_px - u)[m.valid])) < 3e-3
    scaled = ((m.u_px - u) / np.where(m.valid, m.sigma_u_px, 1.0))[m.valid & partly]
    assert 0.7 < np.std(scaled) < 1.5
    assert np.mean(m.sigma_u_px[m.valid & partly]) > 1.1 * np.mean(m.sigma_u_px[m.valid & (fraction == 1.0)])


def test_a_mask_that_hides_nothing_changes_no_byte(lab, scene):
    first, second = lab.expose(scene(), 4.0, 1), lab.expose(scene(lab.Affine(**MOTION)), 4.0, 2)
    plain, masked = correlate(first, second, None)[1], correlate(first, second, np.ones((260, 300), dtype=bool))[1]
    assert np.array_equal(plain.u_px, masked.u_px)
    assert np.array_equal(plain.status, masked.status)


def test_all_masked_is_no_error(lab, scene):
    _, m = correlate(lab.expose(scene()), lab.expose(scene()), np.zeros((260, 300), dtype=bool))
    assert np.all(m.status == PoiStatus.MASKED)


def test_a_mask_of_another_size_is_bad_input(lab, scene):
    with pytest.raises(BadInput, match="the mask is 10 x 20 px but the frame 300 x 260 px: give a mask of its size"):
        correlate(lab.expose(scene()), lab.expose(scene()), np.ones((20, 10), dtype=bool))


@pytest.mark.parametrize("shift", [(0, 0), (12, -7), (-9, 20)])
def test_a_mask_follows_the_specimen_into_another_frame(lab, scene, mask, shift):
    dx, dy = shift
    first, second = lab.expose(scene(), 3.0, 1), lab.expose(scene(lab.Affine(u=float(dx), v=float(dy))), 3.0, 2)
    reference, _ = correlate(first, second, mask)
    moved = dic.moved_mask(mask, reference, second)
    inner = moved[30:-30, 60:-30]
    assert np.array_equal(inner, mask[30 - dy : 230 - dy, 60 - dx : 270 - dx])


def test_a_mask_stays_in_a_frame_in_which_the_specimen_is_not_found(lab, scene, mask):
    first = lab.expose(scene(), 3.0, 1)
    reference, _ = correlate(first, first, mask)
    assert np.array_equal(dic.moved_mask(mask, reference, np.full_like(first, 7)), mask)
