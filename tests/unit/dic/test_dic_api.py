"""The plain call: arrays in, map out."""

import doctest

import numpy as np
import pytest

from semlive import dic
from semlive.dic import api
from semlive.errors import BadInput


def test_the_example_runs():
    outcome = doctest.testmod(api)
    assert outcome.attempted >= 7
    assert outcome.failed == 0


def test_defaults_cover_the_frame(lab, scene):
    first, second = lab.expose(scene(), 2.0, 1), lab.expose(scene(lab.Affine(u=0.4, v=-1.3)), 2.0, 2)
    found = dic.match(first, second)
    assert found.grid == dic.Grid(x0_px=21, y0_px=21, step_px=5, nx=52, ny=44, subset_px=43)
    assert found.valid.mean() > 0.95
    assert np.mean(found.u_px[found.valid]) == pytest.approx(0.4, abs=2e-3)
    assert np.mean(found.v_px[found.valid]) == pytest.approx(-1.3, abs=2e-3)


def test_a_grid_brings_its_subset(lab, scene):
    first, second = lab.expose(scene()), lab.expose(scene(lab.Affine(u=0.4, v=-1.3)))
    grid = dic.Grid(x0_px=50, y0_px=60, step_px=7, nx=9, ny=8, subset_px=31)
    found = dic.match(first, second, grid)
    assert found.grid == grid
    assert found.valid.all()
    same = dic.match(first, second, grid, dic.DicSettings(subset_px=31, step_px=7, roi_px=None))
    assert np.array_equal(found.u_px, same.u_px)


def test_sixteen_bit_is_as_good(lab, scene):
    first, second = lab.expose(scene(), 2.0, 1, bits=16), lab.expose(scene(lab.Affine(u=0.4)), 2.0, 2, bits=16)
    found = dic.match(first, second, settings=dic.DicSettings(step_px=20, roi_px=None))
    assert found.valid.all()
    assert np.mean(found.u_px) == pytest.approx(0.4, abs=4e-3)


GOOD = np.random.default_rng(1).integers(0, 255, (80, 90), dtype=np.uint8)


@pytest.mark.parametrize(
    ("reference", "current", "message"),
    [
        ("ref.tif", GOOD, "the reference image is a str, not an array: read the file first"),
        (GOOD, GOOD.astype(float), "the current image has the type float64, not uint8 or uint16"),
        (np.stack([GOOD] * 3, axis=2), GOOD, r"shape \(80, 90, 3\), not \(height, width\)"),
        (GOOD, GOOD[:60], "is 90 x 80 px but the current image 90 x 60 px"),
        (GOOD[:5], GOOD[:5], "is 90 x 5 px: give at least"),
        (GOOD[:40], GOOD[:40], "no subset of 43 px fits"),
    ],
)
def test_bad_input_gives_one_error_line(reference, current, message):
    with pytest.raises(BadInput, match=message) as caught:
        dic.match(reference, current)
    assert "\n" not in str(caught.value)


def test_a_grid_outside_the_image_is_refused():
    with pytest.raises(BadInput, match=r"from \(-11, 9\) to .* make the grid with grid_for"):
        dic.match(GOOD, GOOD, dic.Grid(x0_px=10, y0_px=30, step_px=5, nx=3, ny=3, subset_px=43))
