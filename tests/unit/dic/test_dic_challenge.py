"""The star benchmark in short: a subset is the filter it should be, and its noise is at the floor."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="module")
def bench(lab):
    sys.modules.setdefault("speckle", lab)
    path = Path(__file__).parents[2] / "benchmarks" / "bench_challenge.py"
    spec = importlib.util.spec_from_file_location("bench_challenge", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["bench_challenge"] = module
    spec.loader.exec_module(module)
    return module


def test_star_images_are_exact(bench):
    star = bench.Star(300, 101)
    y, x = np.mgrid[0:101, 0:300].astype(float)
    _, reference = star.back(x, y)
    assert np.max(np.abs(reference + star.displacement(x, reference) - y)) < 1e-12
    assert np.allclose(star.displacement(np.arange(300.0), np.full(300, 50.0)), 0.5)
    assert star.period_px(np.array([0.0, 299.0])).tolist() == [10.0, 300.0]


def test_theory_is_four_subsets_long(bench):
    # sin(z) / z = 0.9 at z = 0.787
    assert bench.theory_px(43) == pytest.approx(43 * np.pi / 0.787, rel=0.01)


def test_a_subset_resolves_what_it_should_at_the_floor_of_noise(bench, lab):
    star = bench.Star(700, 121)
    speckles = [lab.Speckle(700, 121, seed=31)]
    (line,) = bench.star_lines(star, speckles, (21,), 3.0, 6, {})
    assert line.converged > 0.99
    assert line.resolution_px == pytest.approx(bench.theory_px(21), rel=0.15)
    # 6 draws of some 15 independent subsets know a standard deviation to 8 %.
    assert line.noise_px / line.predicted_px < 1.35
    assert line.stated_px / line.noise_px == pytest.approx(1.0, abs=0.25)
    assert line.efficiency_px2 == pytest.approx(line.resolution_px * line.noise_px)


@pytest.fixture(scope="module")
def star5(lab):
    sys.modules.setdefault("speckle", lab)
    folder = Path(__file__).parents[2] / "benchmarks"
    for name in ("bench_peers", "bench_challenge_star"):
        spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules["bench_challenge_star"]


def test_the_challenges_resolution_is_what_theory_reports_of_a_line(star5):
    period = star5.period_px(np.arange(4000.0))
    assert period[[0, -1]] == pytest.approx([10.0, 299.93], abs=0.01)
    passed = np.sin(np.pi * 17 / period) / (17 * np.sin(np.pi / period))
    rng = np.random.default_rng(1)
    profile = np.where(period < 40.0, np.nan, 0.5 * passed + 0.01 * rng.standard_normal(4000))
    assert star5.resolution_px(profile) == pytest.approx(67.8, rel=0.02)  # the published figure for affine subsets of 17 px
    # A polynomial through what such subsets make of shorter waves, too, runs 5 % flatter.
    assert star5.resolution_px(0.5 * passed) == pytest.approx(71.1, rel=0.01)
    assert np.isnan(star5.resolution_px(np.full(4000, np.nan)))


def test_an_unmoved_exposure_has_the_pairs_noise(star5):
    rng = np.random.default_rng(2)
    y, x = np.mgrid[0:121, 0:4000].astype(float)
    grey = np.clip(120.0 + 40.0 * np.sin(x / 3.0) * np.cos(y / 4.0), 0, 255)
    v = 0.5 * np.cos(2.0 * np.pi * (y - 60) / star5.period_px(x))
    moved = 120.0 + 40.0 * np.sin(x / 3.0) * np.cos((y - v) / 4.0)  # exact where v is zero

    def expose(image):
        return np.rint(image + rng.standard_normal(image.shape) * np.sqrt(1.0 + 0.03 * image)).astype(np.uint8)

    first, second = expose(grey), expose(moved)
    level, slope = star5.noise_by_grey(first, second)
    assert level + slope * 120.0 == pytest.approx(1.0 + 0.03 * 120.0 + 1.0 / 12.0, rel=0.05)
    assert slope == pytest.approx(0.03, rel=0.25)
    again = star5.still(first, second)
    difference = again.astype(float) - first
    for low, high in ((85, 95), (145, 155)):
        at = (first >= low) & (first <= high)
        assert difference[at].var() == pytest.approx(2.0 * (level + slope * 0.5 * (low + high)), rel=0.05)
    assert star5.summary_px2([star5.Cut(9, r, 0.01, 1.0) for r in (50.0, 10.0, 30.0, 20.0)]) == pytest.approx(0.2)
