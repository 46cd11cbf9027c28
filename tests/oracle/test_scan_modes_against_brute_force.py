"""Every way of scanning against a pixel-by-pixel calculation in plain Python: where each visit looks, and what the image becomes."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from semlive_simulators.microscope.render import render_frame
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import Motion, at_rest

WIDTH, HEIGHT, START_S = 72, 51, 5.0
MODES: dict[str, dict[str, Any]] = {
    "plain": {},
    "frame integration": {"integrations": 4},
    "line integration": {"integrations": 3, "integration": "line"},
    "snake": {"direction": "snake"},
    "rotated": {"rotation_rad": math.radians(30)},
    "upside down": {"rotation_rad": math.pi},
    "interlaced": {"interlaced": True},
    "everything": {"integrations": 2, "direction": "snake", "rotation_rad": -0.4, "interlaced": True},
    "everything by line": {"integrations": 3, "integration": "line", "direction": "snake", "interlaced": True},
}


def scenario(bits: int = 16, **scan: Any) -> Scenario:
    paper = load_scenario("paper_x200")
    raster = dataclasses.replace(paper.scan, width_px=WIDTH, height_px=HEIGHT, frame_time_s=HEIGHT * paper.scan.row_time_s, **scan)
    detector = dataclasses.replace(paper.detector, read_noise=0.0, shot_noise=0.0, bits=bits)
    return dataclasses.replace(paper, scan=raster, detector=detector)


def pulled() -> Motion:
    rate = np.array([[-3e-4, -2e-4], [2e-4, 9e-4]])
    return Motion(np.array([0.0, 100.0]), np.array([[0.0, 0.0], [160.0, -90.0]]), np.stack([np.zeros((2, 2)), 10 * rate]))


def visit_s(scan: Scan, x: int, y: int, visit: int) -> float:
    """Seconds from the start of the frame to a visit of a pixel."""
    row_s = scan.frame_time_s / scan.height_px
    turn = y if not scan.interlaced else y // 2 + (y % 2) * math.ceil(scan.height_px / 2)
    begin_s = turn * row_s + visit * scan.frame_time_s if scan.integration == "frame" else (turn * scan.integrations + visit) * row_s
    backwards = scan.direction == "snake" and y % 2 == 1
    return begin_s + (scan.width_px - 1 - x if backwards else x) * scan.dwell_time_s


def brute_point(world: Scenario, motion: Motion, x: int, y: int, visit: int) -> NDArray[np.float64]:
    scan = world.scan
    time_s = START_S + visit_s(scan, x, y, visit)
    state = motion.at(np.array([time_s]))
    centre = np.array([(scan.width_px - 1) / 2, (scan.height_px - 1) / 2])
    cos, sin = math.cos(scan.rotation_rad), math.sin(scan.rotation_rad)
    address = np.array([x, y]) - world.distortion.at(x, y, scan.width_px, scan.height_px) - centre
    beam = centre + np.array([cos * address[0] - sin * address[1], sin * address[0] + cos * address[1]]) - world.drift.at(time_s)
    return centre + np.linalg.solve(np.eye(2) + state.gradient[0], beam - centre - state.shift_px[0])


@pytest.mark.parametrize("mode", MODES.values(), ids=MODES.keys())
def test_every_visit_looks_where_and_when_it_should(mode: dict[str, Any]) -> None:
    world = scenario(**mode)
    column, motion = world.column(), pulled()
    for visit in range(world.scan.integrations):
        x_px, y_px, at = column.specimen_points(range(10, HEIGHT), visit, START_S, motion, 0)
        for y in range(10, HEIGHT, 4):
            for x in (0, 1, 17, 36, WIDTH - 1):
                expected = brute_point(world, motion, x, y, visit)
                assert math.hypot(x_px[y - 10, x] - expected[0], y_px[y - 10, x] - expected[1]) < 1e-4
                assert at.time_s[y - 10, x] == pytest.approx(START_S + visit_s(world.scan, x, y, visit), abs=1e-9)


@pytest.mark.parametrize("integration", ["frame", "line"])
def test_integration_is_the_mean_of_renderings_at_their_own_times(integration: str) -> None:
    world = scenario(integrations=4, integration=integration)
    image = render_frame(world, START_S, pulled())
    single = dataclasses.replace(world, scan=dataclasses.replace(world.scan, integrations=1, integration="frame"))
    row_s, frame_s = world.scan.row_time_s, world.scan.frame_time_s
    if integration == "frame":
        scans = [render_frame(single, START_S + m * frame_s, pulled()) for m in range(4)]
        mean = np.mean(scans, axis=0)
    else:
        mean = np.empty(image.shape)
        for y in range(HEIGHT):
            begin_s = [START_S + (4 * y + m - y) * row_s for m in range(4)]  # a plain frame reaches row y after y rows
            mean[y] = np.mean([render_frame(single, start_s, pulled())[y] for start_s in begin_s], axis=0)
    assert np.abs(image - mean).max() <= 1.0  # levels of 16 bit, two roundings of half a level


def test_general_and_fast_way_agree_pixel_by_pixel() -> None:
    world = load_scenario("paper_x200")
    world = dataclasses.replace(world, scan=dataclasses.replace(world.scan, width_px=200, height_px=150))
    fast = render_frame(world, START_S, pulled(), frame=2)
    slow = np.empty_like(fast)
    world.column()._expose(slow, 0, START_S, pulled(), 2)
    different = fast != slow
    assert different.mean() < 1e-5  # another order of sums, on the edge between two levels
    assert np.abs(fast.astype(int) - slow).max() <= 1


def test_sixteen_bits_are_the_same_image_in_finer_steps() -> None:
    coarse, fine = render_frame(scenario(bits=8)), render_frame(scenario(bits=16))
    assert (coarse.dtype, fine.dtype) == (np.uint8, np.uint16)
    assert np.abs(fine / 256.0 - coarse).max() <= 0.5 + 1 / 256
    assert len(np.unique(fine)) > 1000


def test_a_spot_blurs_like_a_gaussian() -> None:
    sharp, blurred = render_frame(scenario(), START_S), render_frame(scenario(spot_px=0.8), START_S)
    many = np.zeros(sharp.shape)
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    for node_x, weight_x in zip(nodes, weights, strict=True):
        for node_y, weight_y in zip(nodes, weights, strict=True):
            moved = at_rest((0.8 * node_x, 0.8 * node_y))
            many += weight_x * weight_y / (2 * math.pi) * render_frame(scenario(), START_S, moved)
    assert np.abs(blurred - many).max() < 256 * 1.0  # one level of 8 bit; the sharp picture is off by
    assert np.abs(sharp - many).max() > 256 * 5.0  # ... more than five


def test_a_cubic_drift_is_a_cubic() -> None:
    drift = dataclasses.replace(load_scenario("paper_x200").drift.x, warmup_px=0.0, cubic_px_s3=2e-9)
    time_s = np.array([0.0, 10.0, 3000.0])
    expected = drift.linear_px_s * time_s + drift.quadratic_px_s2 * time_s**2 + 2e-9 * time_s**3
    np.testing.assert_allclose(drift.at(time_s), expected, rtol=1e-12)
