"""The shape function of fourth order: what it resolves, and its stated uncertainty."""

from dataclasses import dataclass

import numpy as np
import pytest

from semlive import dic
from semlive.data.settings import DicSettings

SUBSET_PX, AMPLITUDE_PX, PERIOD_PX = 33, 0.15, 33.0


@dataclass(frozen=True)
class Wave:
    """v = A cos(2 pi y / period)."""

    def at(self, x, y):
        return np.zeros_like(x), AMPLITUDE_PX * np.cos(2.0 * np.pi * y / PERIOD_PX)

    def back(self, x, y):
        rows = np.arange(y.max() + 1.0)
        found = rows
        for _ in range(25):  # contracts by 0.03 a step
            found = rows - self.at(rows, found)[1]
        return x, found[np.rint(y).astype(int)]


def passed(degree):
    """Fraction of a wave along y that the least-squares polynomial of a subset has at its centre."""
    half = SUBSET_PX // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    terms = np.stack([(x / half) ** (n - k) * (y / half) ** k for n in range(degree + 1) for k in range(n + 1)], axis=-1)
    wave = np.cos(2.0 * np.pi * y / PERIOD_PX)
    return np.linalg.lstsq(terms.reshape(SUBSET_PX**2, -1), wave.ravel(), rcond=None)[0][0]


@pytest.mark.parametrize(("shape_function", "degree"), [("quadratic", 2), ("quartic", 4)])
def test_a_subset_passes_the_fraction_of_a_wave_that_theory_gives(lab, shape_function, degree):
    speckle = lab.Speckle(260, 140, seed=5)
    first, second = lab.expose(speckle.render(), bits=16), lab.expose(speckle.render(Wave()), bits=16)
    settings = DicSettings(SUBSET_PX, 4, (25, 25, 234, 114), shape_function=shape_function)
    m = dic.match(first, second, dic.grid_for(settings, 260, 140), settings)
    assert m.valid.mean() > 0.99
    wave = Wave().at(*m.grid.mesh())[1]
    fraction = np.sum((m.v_px * wave)[m.valid]) / np.sum(wave[m.valid] ** 2)
    # A subset has some 40 speckles; whose gradients weight it differs from point to point
    assert fraction == pytest.approx(passed(degree), abs=0.02)
    assert (fraction > 0.95) == (shape_function == "quartic")


def test_the_stated_uncertainty_is_that_of_repeated_frames(lab, scene):
    settings = DicSettings(step_px=20, roi_px=(40, 40, 260, 220), shape_function="quartic")
    grid, motion = dic.grid_for(settings, 300, 260), lab.Affine(u=0.4, v=-0.3, ux=1e-3, xc=150, yc=130)
    maps = [
        dic.match(lab.expose(scene(), 5.0, 2 * draw), lab.expose(scene(motion), 5.0, 2 * draw + 1), grid, settings) for draw in range(16)
    ]
    assert all(m.valid.all() for m in maps)
    for found, sigma in (("u_px", "sigma_u_px"), ("v_px", "sigma_v_px")):
        observed = np.sqrt(np.mean(np.var([getattr(m, found) for m in maps], axis=0, ddof=1)))
        stated = np.sqrt(np.mean(np.square([getattr(m, sigma) for m in maps])))
        # 16 draws of some 30 independent subsets determine a standard deviation to 3.5 %
        assert stated / observed == pytest.approx(1.0, abs=0.08)
    truth = motion.at(*grid.mesh())
    for found, true in zip(("u_px", "v_px"), truth, strict=True):
        assert abs(np.mean([getattr(m, found) - true for m in maps])) < 2e-3


def test_masked_pixels_change_nothing(lab, scene, measure):
    first, second = lab.expose(scene(), 2.0, 1), lab.expose(scene(lab.Affine(u=0.4, v=-0.3)), 2.0, 2)
    mask = np.ones(first.shape, dtype=bool)
    mask[100:112, 140:155] = False
    settings = DicSettings(step_px=24, roi_px=(60, 60, 240, 200), shape_function="quartic")
    grid = dic.grid_for(settings, 300, 260)
    maps = [dic.match(np.where(mask, first, grey).astype(np.uint8), second, grid, settings, mask=mask) for grey in (0, 255)]
    assert maps[0].valid.all()
    for name in ("u_px", "v_px", "sigma_u_px", "zncc"):
        assert np.array_equal(getattr(maps[0], name), getattr(maps[1], name)), name
    whole = measure(first, second, settings)
    assert np.all(maps[0].sigma_u_px >= whole.sigma_u_px * 0.99)
    assert np.any(maps[0].sigma_u_px > whole.sigma_u_px * 1.05)
