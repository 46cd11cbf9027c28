"""A prior of the motion helps: a regular grid of dots is not ambiguous if nothing moved by half of its pitch."""

import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import PoiStatus
from semlive.data.settings import DicSettings

PITCH_PX = 18.0
LARGE = {"subset_px": 31, "step_px": 8, "roi_px": (40, 40, 260, 220)}


def dots(u, v, noise, seed, height=260, width=300):
    """Dots on a square lattice, drawn where they are."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    dx, dy = ((a + PITCH_PX / 2) % PITCH_PX - PITCH_PX / 2 for a in (x - u, y - v))
    grey = 60.0 + 130.0 * np.exp(-0.5 * (dx**2 + dy**2) / 3.0**2)
    return np.clip(np.round(grey + noise * np.random.default_rng(seed).standard_normal(grey.shape)), 0, 255).astype(np.uint8)


def test_a_grid_of_dots_is_ambiguous_without_a_motion_prior():
    m = dic.match(dots(0, 0, 3.0, 1), dots(2.3, -3.6, 3.0, 2), settings=DicSettings(**LARGE))
    assert np.all(m.status == PoiStatus.AMBIGUOUS)


@pytest.mark.parametrize("shift", [(2.3, -3.6), (-6.4, 6.1)])
def test_a_grid_of_dots_is_measured_when_it_moved_by_less_than_half_its_pitch(shift):
    u, v = shift
    m = dic.match(dots(0, 0, 3.0, 1), dots(u, v, 3.0, 2), settings=DicSettings(**LARGE, search_px=8.0))
    assert m.valid.mean() > 0.99
    assert np.max(np.abs(m.u_px - u)[m.valid]) < 0.06
    assert np.max(np.abs(m.v_px - v)[m.valid]) < 0.06


def test_motion_that_may_reach_the_next_dot_stays_ambiguous():
    m = dic.match(dots(0, 0, 3.0, 1), dots(2.3, -3.6, 3.0, 2), settings=DicSettings(**LARGE, search_px=10.0))
    assert np.all(m.status == PoiStatus.AMBIGUOUS)


def test_nothing_is_looked_for_beyond_what_was_reported(lab, scene):
    moved = lab.expose(scene(lab.Affine(u=20.0, v=1.0)), 3.0, 2)
    far = dic.match(lab.expose(scene(), 3.0, 1), moved, settings=DicSettings(**LARGE, search_px=10.0))
    assert not far.valid.any()
    found = dic.match(lab.expose(scene(), 3.0, 1), moved, settings=DicSettings(**LARGE, search_px=25.0))
    assert found.valid.mean() > 0.99


def test_a_wide_search_is_the_same_as_none(lab, scene):
    first, second = lab.expose(scene(), 3.0, 1), lab.expose(scene(lab.Affine(u=20.0, v=1.0)), 3.0, 2)
    wide, none = (dic.match(first, second, settings=DicSettings(**LARGE, search_px=s)) for s in (64.0, None))
    assert np.array_equal(wide.u_px, none.u_px)
    assert np.array_equal(wide.status, none.status)


def test_a_search_must_be_somewhere():
    with pytest.raises(ValueError, match="search_px must be above 0, not 0"):
        DicSettings(search_px=0.0)
