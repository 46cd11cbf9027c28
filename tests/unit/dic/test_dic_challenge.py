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
