"""Where the beam looks on a sheet with a hole or a notch and with grains, by complex numbers and plain sums at one point at a time."""

from __future__ import annotations

import cmath
import dataclasses
import math
import random
from collections.abc import Callable

import numpy as np
import pytest

from semlive_simulators.effects.library import build_effects
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import at_rest

START_S, FORCE_N, NU = 900.0, 2200.0, 0.33
FAR_STRAIN = FORCE_N / (10.0 * 71.1e3)
Ellipse = tuple[float, float, float, float]  # middle from the centre of the frame, half axes
HOLE: Ellipse = (0.0, 0.0, 150.0, 150.0)
NOTCH: Ellipse = (-200.0 - 800.0, 0.0, 800.0, math.sqrt(800.0 * 60.0))
CASES = {
    "hole": ("paper_x200", "hole", HOLE, 160.0),
    "notch": ("paper_x200", "notch", NOTCH, 160.0),
    "notch, 16 visits": ("paper_x10000", "notch", NOTCH, 250.0),
}


def scrambled(z: int) -> int:
    mask = (1 << 64) - 1
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def conformal(ellipse: Ellipse, x: float, y: float) -> tuple[complex, float, float]:
    """zeta, R and m for a point from the centre of the frame."""
    size, m = 0.5 * (ellipse[2] + ellipse[3]), (ellipse[2] - ellipse[3]) / (ellipse[2] + ellipse[3])
    z = complex(x - ellipse[0], y - ellipse[1]) / size
    root = cmath.sqrt(z * z - 4 * m)
    return max((0.5 * (z + root), 0.5 * (z - root)), key=abs), size, m


def opened(ellipse: Ellipse, x: float, y: float) -> complex:
    """Muskhelishvili's potentials with the hole less those without it, at strain 1 far away."""
    zeta, size, m = conformal(ellipse, x, y)
    if abs(zeta) < 1.0:
        zeta /= abs(zeta)
    z, kappa = size * (zeta + m / zeta), (3 - NU) / (1 + NU)
    phi = size / 4 * (zeta - (2 + m) / zeta) - z / 4
    slope = size / 4 * (1 + (2 + m) / zeta**2) / (size * (1 - m / zeta**2)) - 0.25
    psi = size / 2 * (zeta - ((1 + m + m * m) * zeta**2 + 1) / (zeta * (zeta**2 - m))) - z / 2
    return (1 + NU) * (kappa * phi - z * slope.conjugate() - psi.conjugate())


def bumps(seed: int, grain_px: float, x: float, y: float) -> float:
    mask, value = (1 << 64) - 1, 0.0
    for row in range(math.floor(y / grain_px) - 2, math.floor(y / grain_px) + 3):
        for column in range(math.floor(x / grain_px) - 2, math.floor(x / grain_px) + 3):
            bits = scrambled((scrambled((seed + column * 0x9E3779B97F4A7C15) & mask) + row * 0xC2B2AE3D27D4EB4F) & mask)
            for _ in range(2):
                bits = scrambled((bits + 0xC2B2AE3D27D4EB4F) & mask)
                jx, jy, jz = (((bits >> shift) & 0xFFFF) / 65536 for shift in (0, 16, 32))
                square = (x / grain_px - column - jx) ** 2 + (y / grain_px - row - jy) ** 2
                value += math.sqrt(3) * (2 * jz - 1) * max(0.0, 1 - square) ** 4 / math.sqrt(2 * math.pi / 9)
    return value


def displaced(ellipse: Ellipse, grain_px: float, x: float, y: float) -> complex:
    """w at a point from the centre of the frame: the opening's share and that of the grains (seed 2)."""
    size = 2e-7 * FORCE_N * grain_px / math.sqrt(36 / 7)
    across, along = (bumps(seed, grain_px, x + 511.5, y + 441.5) for seed in (4, 5))
    return FAR_STRAIN * opened(ellipse, x, y) + complex(-0.5 * size * across, size * along)


def imaged_point(world: Scenario, w: Callable[[float, float], complex], x: int, y: int, visit: int) -> complex:
    """From the centre; solved by repetition until nothing changes any more."""
    scan = world.scan
    time_s = START_S + (visit * scan.height_px + y) * scan.frame_time_s / scan.height_px + x * scan.dwell_time_s
    ex, ey = world.distortion.at(x, y, scan.width_px, scan.height_px)
    drift = [
        own.warmup_px * (1 - math.exp(-time_s / own.warmup_s)) + own.linear_px_s * time_s + own.quadratic_px_s2 * time_s**2
        for own in (world.drift.x, world.drift.y)
    ]
    px, py = x - ex - 511.5 - drift[0] - 13.0, y - ey - 441.5 - drift[1] + 31.0
    found = complex(px, py)
    for _ in range(60):
        more = w(found.real, found.imag)
        # p = xi + G xi + w with G = ((-nu e, -r), (r, e)): the trace of G is small, so that repetition closes in
        gx = -NU * FAR_STRAIN * found.real - 1.1e-4 * found.imag
        gy = 1.1e-4 * found.real + FAR_STRAIN * found.imag
        last, found = found, complex(px - gx - more.real, py - gy - more.imag)
        if abs(found - last) < 1e-13:
            break
    return found


@pytest.mark.parametrize(("name", "opening", "ellipse", "grain_px"), CASES.values(), ids=CASES.keys())
def test_the_beam_looks_where_brute_force_reports(name: str, opening: str, ellipse: Ellipse, grain_px: float) -> None:
    magnification = name.removeprefix("paper_")
    world = load_scenario(name)
    world = dataclasses.replace(world, effects=build_effects({opening: magnification, "grain_strain": magnification}))
    motion = at_rest((13.0, -31.0), [[-NU * FAR_STRAIN, -1.1e-4], [1.1e-4, FAR_STRAIN]], FORCE_N)
    column, choice = world.column(), random.Random(3)
    visit, worst, near = column.visits - 1, 0.0, 0
    for first in (0, 280, 430, 450, 590, 880):
        x_px, y_px, _ = column.specimen_points(range(first, first + 4), visit, START_S, motion, 0)
        for _ in range(30):
            # half of them where the opening's edge is, wherever drift and shift have carried it
            x, y = choice.randrange(1024) if choice.random() < 0.5 else choice.randrange(250, 420), choice.randrange(4)
            expected = imaged_point(world, lambda a, b: displaced(ellipse, grain_px, a, b), x, first + y, visit)
            near += abs(conformal(ellipse, expected.real, expected.imag)[0]) < 1.1
            worst = max(worst, abs(complex(x_px[y, x], y_px[y, x]) - complex(511.5, 441.5) - expected))
    assert near > 10
    assert worst < 1e-4  # found: 4.3e-7 px at most


def test_strips_of_a_deformed_specimen_equal_the_complete_frame_to_the_last_bit() -> None:
    world = load_scenario("paper_x200")
    scan = dataclasses.replace(world.scan, width_px=203, height_px=75, frame_time_s=75 * world.scan.row_time_s)
    chosen = build_effects(dict.fromkeys(("hole", "notch", "grain_strain", "grain_contrast"), "x200"))
    world = dataclasses.replace(world, scan=scan, effects=chosen)
    motion, column = at_rest(load_n=FORCE_N), world.column()
    whole, pieces = render_frame(world, 5.0, motion, 2, column), np.empty((75, 203), dtype=np.uint8)
    for first, end in ((0, 1), (1, 34), (34, 71), (71, 75)):
        column.render_rows(pieces[first:end], first, 5.0, motion, 2)
    np.testing.assert_array_equal(pieces, whole)
