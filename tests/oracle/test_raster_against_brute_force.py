"""The raster kernel against a slow, separate implementation in plain numpy and Python integers."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from semlive_simulators.microscope.column import Column
from semlive_simulators.microscope.patterns import Speckle
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import Motion, at_rest

MASK = (1 << 64) - 1


def small(width: int = 96, height: int = 64, noise: bool = False) -> Scenario:
    paper = load_scenario("paper_x200")
    scan = dataclasses.replace(paper.scan, width_px=width, height_px=height, frame_time_s=height * paper.scan.row_time_s)
    detector = paper.detector if noise else dataclasses.replace(paper.detector, read_noise=0.0, shot_noise=0.0)
    return dataclasses.replace(paper, scan=scan, detector=detector)


def steady_motion() -> Motion:
    """A specimen that is pulled, turned and carried along all through the scan."""
    rate = np.array([[-3e-4, -2e-4], [2e-4, 9e-4]])
    return Motion(np.array([0.0, 100.0]), np.array([[0.0, 0.0], [160.0, -90.0]]), np.stack([np.zeros((2, 2)), 10 * rate]))


def imaged_points(scenario: Scenario, start_s: float, motion: Motion) -> NDArray[np.float64]:
    """Material point of every pixel, each at its own time, solved from the forward model: (height, width, 2)."""
    scan = scenario.scan
    points = np.empty((scan.height_px, scan.width_px, 2))
    centre = np.array([(scan.width_px - 1) / 2, (scan.height_px - 1) / 2])
    for y in range(scan.height_px):
        for x in range(scan.width_px):
            time_s = start_s + y * scan.row_time_s + x * scan.dwell_time_s
            state = motion.at(np.array([time_s]))
            address = np.array([x, y], dtype=float)
            beam = address - scenario.distortion.at(x, y, scan.width_px, scan.height_px) - scenario.drift.at(time_s)
            forward = np.eye(2) + state.gradient[0]
            points[y, x] = centre + np.linalg.solve(forward, beam - centre - state.shift_px[0])
    return points


def kernel_points(column: Column, start_s: float, motion: Motion) -> NDArray[np.float64]:
    """The same by the maps that the kernel is given."""
    scan = column.scan
    rows = np.arange(scan.height_px + 1)
    maps = column.row_maps(start_s + rows * scan.row_time_s, motion)
    x_px, y_px = np.meshgrid(np.arange(scan.width_px), np.arange(scan.height_px))
    beam = np.stack([x_px - column.distortion_px[0], y_px - column.distortion_px[1], np.ones(x_px.shape)], axis=-1)
    ends = [np.einsum("yij,yxj->yxi", part, beam) for part in (maps[:-1], maps[1:])]
    fraction = (np.arange(scan.width_px) * scan.dwell_time_s / scan.row_time_s)[None, :, None]
    return (1 - fraction) * ends[0] + fraction * ends[1]


def scrambled(z: int) -> int:
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def gold_at(speckle: Speckle, point: NDArray[np.float64]) -> float:
    """Coverage at a point from all dots within two cells, one more than can reach it."""
    plain = 1.0
    middle = [math.floor(value / speckle.pitch_px) for value in point]
    for row in range(middle[1] - 2, middle[1] + 3):
        for column in range(middle[0] - 2, middle[0] + 3):
            inner = scrambled((speckle.seed + column * 0x9E3779B97F4A7C15) & MASK)
            bits = scrambled((inner + row * 0xC2B2AE3D27D4EB4F) & MASK)
            jx, jy, jr, jp = (((bits >> shift) & 0xFFFF) / 65536 for shift in (0, 16, 32, 48))
            if jp >= speckle.presence:
                continue
            radius = speckle.radius_px * (1 + speckle.radius_spread * (2 * jr - 1))
            distance = math.hypot(point[0] - (column + jx) * speckle.pitch_px, point[1] - (row + jy) * speckle.pitch_px)
            t = min(1.0, max(0.0, (radius + speckle.edge_px - distance) / (2 * speckle.edge_px)))
            plain *= 1 - (0.85 + 0.15 * jp / speckle.presence) * (6 * t**5 - 15 * t**4 + 10 * t**3)
    return 1 - plain


@pytest.mark.parametrize(
    ("start_s", "motion"), [(0.0, at_rest()), (5.0, steady_motion()), (4000.0, at_rest((-37.2, 21.9), [[0, 1e-4], [-1e-4, 3e-3]]))]
)
def test_every_pixel_images_the_point_of_its_own_time_and_place(start_s: float, motion: Motion) -> None:
    scenario = small()
    expected = imaged_points(scenario, start_s, motion)
    assert np.abs(kernel_points(scenario.column(), start_s, motion) - expected).max() < 1e-4
    image = render_frame(scenario, start_s, motion)
    grey = np.array([[gold_at(scenario.speckle, expected[y, x]) for x in range(96)] for y in range(64)])
    grey = scenario.detector.offset + scenario.detector.gain * grey
    # Half a grey level of rounding, and 1e-4 px times the steepest slope of some 40 grey levels per px.
    assert np.abs(image - grey).max() < 0.5 + 0.005


def test_a_shift_to_the_right_moves_the_image_to_the_right() -> None:
    scenario = small()
    flat = dataclasses.replace(scenario.distortion.x, constant_px=0, xx_px=0, xy_px=0, yy_px=0, wave_px=0)
    calm = dataclasses.replace(scenario.drift.x, warmup_px=0, linear_px_s=0, quadratic_px_s2=0)
    scenario = dataclasses.replace(
        scenario,
        distortion=dataclasses.replace(scenario.distortion, x=flat, y=flat),
        drift=dataclasses.replace(scenario.drift, x=calm, y=calm),
    )
    first, second = render_frame(scenario), render_frame(scenario, motion=at_rest((7, -3)))
    assert np.array_equal(first[3:, :-7], second[:-3, 7:])
    drifting = dataclasses.replace(calm, linear_px_s=0.01)
    moved = render_frame(dataclasses.replace(scenario, drift=dataclasses.replace(scenario.drift, x=drifting)), start_time_s=700.0)
    late = np.abs(moved[:4, 7:].astype(int) - first[:4, :-7].astype(int)).max()
    assert late <= 1  # 0.004 px of drift within four rows


def test_the_same_seed_gives_the_same_bytes_in_strips_and_at_once() -> None:
    scenario = small(noise=True)
    column = scenario.column()
    whole = render_frame(scenario, 10.0, frame=3)
    strips = np.empty_like(whole)
    for first in range(0, 64, 24):
        column.render_rows(strips[first : first + 24], first, 10.0, at_rest(), 3)
    assert np.array_equal(whole, strips)
    assert not np.array_equal(whole, render_frame(scenario, 10.0, frame=4))


def test_noise_is_white_normal_and_as_large_as_the_detector_reports() -> None:
    noisy, clean = small(384, 256, noise=True), small(384, 256)
    signal = render_frame(clean).astype(float)
    noise = render_frame(noisy, frame=7) - signal
    variance = noisy.detector.read_noise**2 + noisy.detector.shot_noise * signal + 2 / 12  # both images are rounded
    normal = noise / np.sqrt(variance)
    count = normal.size  # 98,304: standard errors 0.0032 for a mean, 0.0023 for a standard deviation
    assert abs(normal.mean()) < 4 / math.sqrt(count)
    assert abs(normal.std() - 1) < 4 / math.sqrt(2 * count)
    for step in ((0, 1), (1, 0), (0, 2), (1, 1)):
        shifted = np.roll(normal, step, axis=(0, 1))
        assert abs((normal * shifted).mean()) < 4.5 / math.sqrt(count)
    other = (render_frame(noisy, frame=8) - signal) / np.sqrt(variance)
    assert abs((normal * other).mean()) < 4.5 / math.sqrt(count)
