"""The rendered hard rasters: their truth, what is matchable, what is wrong, and what correlation reaches on a few of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bench_rendered_rasters import MIN_SHARE, measure, table
from rasters.detector import Noise
from rasters.judge import Count, judge
from rasters.matchable import TEMPLATE_PX, at_second, inside, matchable, near_step, sigma_bound_px
from rasters.motion import random_rows
from rasters.scenes import DISTURBANCES, NAMES, Scene, render, scene

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid

GRID = Grid(30, 30, 12, 22, 19, 43)


@cache
def rendered(disturbance: str) -> Scene:
    """A scene of several tests, rendered once; none of them changes it."""
    return render("speckle", DISTURBANCES[disturbance], disturbance, 7)


def true_map(s: Scene, sigma_px: float = 0.02) -> DisparityMap:
    """A map without errors."""
    x, y = (a.astype(int) for a in GRID.mesh())
    sigma = np.full(GRID.shape, sigma_px)
    return DisparityMap(0, 1, GRID, s.u[y, x], s.v[y, x], sigma, sigma, np.ones(GRID.shape), np.zeros(GRID.shape, np.uint8))


@pytest.mark.parametrize("disturbance", ["none", "row jumps"])
def test_the_second_frame_shows_the_first_at_the_true_positions(disturbance: str) -> None:
    s = rendered(disturbance)
    observed = inside(s) & ~near_step(s)
    assert observed.mean() > 0.3
    difference = (at_second(s, s.clean_second, 0.0) - s.clean_first)[observed]
    slope = np.std(np.gradient(s.clean_first, axis=1))
    assert np.std(difference) < 0.01 * slope  # true within a hundredth of a pixel, interpolation of the frame included
    assert np.std((s.clean_second - s.clean_first)[observed]) > slope  # and they moved


def test_row_shifts_have_their_size_and_no_slow_part() -> None:
    rows = [random_rows(np.random.default_rng(seed), jitter_px=1.0) for seed in range(40)]
    assert np.std([r.single[0] for r in rows]) == pytest.approx(1.0, abs=0.05)
    means = [np.convolve(r.single[0], np.ones(43) / 43.0, mode="valid") for r in rows]
    assert np.std(means) < 0.06  # white shifts have 0.15
    assert not rows[0].step_rows.size


def test_the_bound_is_that_of_the_gradients_and_grows_with_noise_and_row_shifts() -> None:
    x, y = (a.astype(int) for a in GRID.mesh())
    bounds = {}
    for name, disturbance in (
        ("noise 2", DISTURBANCES["none"]),
        ("noise 8", replace(DISTURBANCES["none"], noise=Noise(8.0))),
        ("shifted", DISTURBANCES["rows shifted 2 px"]),
        ("gain", DISTURBANCES["row brightness"]),
    ):
        s = render("speckle", disturbance, "of one name", 7)
        bounds[name] = np.median(sigma_bound_px(s, x.ravel()[::7], y.ravel()[::7]))
        if name == "noise 2":
            gradient = np.mean(np.gradient(s.clean_first, axis=1) ** 2)
            assert bounds[name] == pytest.approx(np.sqrt(2.0 * (4.0 + 1.0 / 12.0) / gradient) / TEMPLATE_PX, rel=0.15)
    assert bounds["noise 8"] == pytest.approx(4.0 * bounds["noise 2"], rel=0.05)
    assert bounds["shifted"] > 2.0 * bounds["noise 2"]
    assert 1.0 < bounds["gain"] / bounds["noise 2"] < 1.5


def test_nothing_is_matchable_without_contrast_at_the_edge_or_across_a_step() -> None:
    x, y = (a.astype(int) for a in GRID.mesh())
    faint = render("speckle", replace(DISTURBANCES["none"], contrast=0.02), "none", 7)
    assert not matchable(faint, x, y).any()
    jumps = rendered("row jumps")
    given = matchable(jumps, x, y)
    assert 0.2 < given.mean() < 0.9
    row = jumps.optics[0].rows.step_rows[0]
    assert not given[np.abs(GRID.y_px - row) < TEMPLATE_PX // 2].any()
    assert not matchable(jumps, np.array([10]), np.array([150])).any()


@pytest.mark.parametrize(
    ("error_px", "sigma_px", "wrong"), [(0.0, 0.02, False), (0.45, 0.02, False), (0.55, 0.02, True), (1.5, 0.4, False), (2.1, 0.6, True)]
)
def test_what_is_wrong(error_px: float, sigma_px: float, wrong: bool) -> None:
    s = rendered("none")
    m = true_map(s, sigma_px)
    moved = np.array(m.v_px)
    moved[5, 6] += error_px
    found = judge(s, replace(m, v_px=moved)).wrong
    assert found.sum() == (1 if wrong else 0)
    assert found[5, 6] == wrong


def test_next_to_a_step_the_values_of_both_sides_are_right_and_no_others() -> None:
    s = rendered("row jumps")
    row = s.optics[0].rows.step_rows[0]
    m = true_map(s)
    k = int(np.argmin(np.abs(GRID.y_px - row)))
    sides = [s.u[row + way, GRID.x_px[6].astype(int)] for way in (-20, 20)]
    assert abs(sides[1] - sides[0]) > 1.5
    for value, wrong in ((np.mean(sides), False), (sides[0], False), (max(sides) + 1.0, True)):
        u = np.array(m.u_px)
        u[k, 6] = value
        assert judge(s, replace(m, u_px=u)).wrong[k, 6] == wrong


def test_the_table_counts_disturbances_below_the_bar() -> None:
    good, poor = (
        Count(points=100, matchable=80, matched=80, converged=90),
        Count(points=100, matchable=80, matched=70, converged=70, wrong=1),
    )
    text = table({("grains", "none"): good, ("grains", "charging"): poor})
    assert "| charging | 100 | 80 | 87.5 | 1 |" in text
    assert "| all | 200 | 160 | 93.8 | 1 |" in text
    assert "1 of 2 disturbances reach 95 %" in text
    assert scene(len(NAMES)).texture == NAMES[0][0]


@pytest.mark.parametrize("key", [("speckle", "rows shifted 0.2 px"), ("heights", "none")])
def test_matchable_points_are_measured(key: tuple[str, str]) -> None:
    c = measure(NAMES.index(key))
    assert c.matchable > 1000
    assert c.wrong == 0
    assert c.share >= MIN_SHARE


@pytest.mark.parametrize(
    "key",
    [
        ("grains", "row brightness"),
        ("grains", "rows shifted 2 px"),
        ("deflection", "weak contrast"),
        ("heights", "probe microscope"),
    ],
)
def test_matchable_points_of_disturbed_rasters_are_measured(key: tuple[str, str]) -> None:
    c = measure(NAMES.index(key))
    assert c.matchable > 1000
    assert c.wrong == 0
    assert c.share >= MIN_SHARE
