"""Deformation fields against closed formulas: Kirsch, Inglis, Ramberg and Osgood, and the statistics of random grains."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from semlive_simulators.effects.library import MATERIAL, as_mapping, build_effects
from semlive_simulators.kernels.grains import grain_grey, smooth_field
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.elliptic import EllipticHole
from semlive_simulators.specimen.history import History, LoadStep
from semlive_simulators.specimen.specimen import Motion, at_rest
from semlive_simulators.specimen.strain_field import strain_field
from semlive_simulators.truth import frame_truth

NU = 0.33
ELLIPSES = [(120.0, 120.0), (200.0, 60.0), (50.0, 170.0)]


def gradients(hole: EllipticHole, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """du_i/dx_j of what the hole adds at strain 1, (2, 2, n), by central differences."""
    h = 1e-3
    along_x = np.array(hole.displacement_px(x + h, y, 1.0, NU)) - np.array(hole.displacement_px(x - h, y, 1.0, NU))
    along_y = np.array(hole.displacement_px(x, y + h, 1.0, NU)) - np.array(hole.displacement_px(x, y - h, 1.0, NU))
    return np.stack([along_x, along_y], axis=1) / (2 * h)


def stresses(hole: EllipticHole, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Total plane stress over p, (2, 2, n): far tension along y and the hole."""
    gradient = gradients(hole, x, y)
    exx, eyy = gradient[0, 0] - NU, gradient[1, 1] + 1.0
    shear = (gradient[0, 1] + gradient[1, 0]) / (2 * (1 + NU))
    return np.array([[(exx + NU * eyy) / (1 - NU**2), shear], [shear, (eyy + NU * exx) / (1 - NU**2)]])


def test_a_round_hole_is_kirschs() -> None:
    radius, hole = 80.0, EllipticHole(0.0, 0.0, 80.0, 80.0)
    r, theta = np.meshgrid(np.array([80.0, 95.0, 160.0, 700.0]), np.linspace(0, 2 * np.pi, 25))
    x, y = r * np.sin(theta), r * np.cos(theta)  # theta from the direction of pull
    kappa = (3 - NU) / (1 + NU)
    scale = radius * 2 * (1 + NU) / 8  # p a / (8 G) at p / E = 1
    outwards = scale * (2 * radius / r * (1 + (kappa + 1) * np.cos(2 * theta)) - 2 * (radius / r) ** 3 * np.cos(2 * theta))
    around = -scale * (2 * radius / r * (kappa - 1) + 2 * (radius / r) ** 3) * np.sin(2 * theta)
    u, v = hole.displacement_px(x, y, 1.0, NU)
    np.testing.assert_allclose(u, outwards * np.sin(theta) + around * np.cos(theta), atol=1e-9)
    np.testing.assert_allclose(v, outwards * np.cos(theta) - around * np.sin(theta), atol=1e-9)


@pytest.mark.parametrize("semi_px", ELLIPSES)
def test_the_edge_of_a_hole_is_free_and_its_ends_concentrate_as_inglis_reports(semi_px: tuple[float, float]) -> None:
    hole = EllipticHole(0.0, 0.0, *semi_px)
    angle = np.linspace(0.05, 2 * np.pi, 40)
    just = 1.0 + 1e-4  # differences need points on both sides
    x, y = just * semi_px[0] * np.cos(angle), just * semi_px[1] * np.sin(angle)
    normal = np.array([np.cos(angle) / semi_px[0], np.sin(angle) / semi_px[1]])
    normal /= np.linalg.norm(normal, axis=0)
    traction = np.einsum("ijn,jn->in", stresses(hole, x, y), normal)
    assert np.abs(traction).max() < 2e-2 * hole.concentration
    tip = stresses(hole, np.array([semi_px[0] + 0.002]), np.array([0.0]))
    assert tip[1, 1, 0] == pytest.approx(hole.concentration, rel=2e-3)
    far = stresses(hole, np.array([3e4, 0.0, -2e4]), np.array([0.0, 3e4, 2e4]))
    np.testing.assert_allclose(far, np.array([[0.0, 0.0], [0.0, 1.0]])[:, :, None] * np.ones(3), atol=1e-4)


@pytest.mark.parametrize("semi_px", ELLIPSES)
def test_stresses_around_a_hole_are_in_equilibrium(semi_px: tuple[float, float]) -> None:
    hole, h = EllipticHole(10.0, -20.0, *semi_px), 0.2
    x, y = np.array([250.0, -260.0, 30.0, 200.0, -300.0]), np.array([10.0, -150.0, 220.0, 190.0, 3.0])
    along_x = (stresses(hole, x + h, y) - stresses(hole, x - h, y)) / (2 * h)
    along_y = (stresses(hole, x, y + h) - stresses(hole, x, y - h)) / (2 * h)
    assert np.abs(along_x[:, 0] + along_y[:, 1]).max() < 1e-6
    assert np.abs(along_x).max() > 1e-4


def scene(width: int = 160, height: int = 120, **effects: object) -> Scenario:
    paper = load_scenario("paper_x200")
    scan = dataclasses.replace(paper.scan, width_px=width, height_px=height, frame_time_s=height * paper.scan.row_time_s)
    silent = dataclasses.replace(paper.detector, read_noise=0.0, shot_noise=0.0, bits=16)
    return dataclasses.replace(paper, scan=scan, detector=silent, effects=build_effects(effects))


HOLE = {"defaults": "x200", "radius_px": 20.0}
NOTCH = {"defaults": "x200", "tip_x_px": -30.0, "tip_radius_px": 20.0, "depth_px": 100.0}
GRAINS = {"defaults": "x200", "grain_px": 25.0}


@pytest.mark.parametrize("chosen", [{"hole": HOLE}, {"notch": NOTCH}, {"grain_strain": GRAINS}, {"hole": HOLE, "grain_strain": GRAINS}])
def test_the_image_shows_each_point_at_its_true_position(chosen: dict[str, object]) -> None:
    world, force = dataclasses.replace(scene(), effects=build_effects(chosen)), 1500.0
    motion = at_rest((1.3, -0.7), world.specimen.gradient(force), force)
    column = world.column()
    x_px, y_px, at = column.specimen_points(range(120), 0, 0.0, motion, 0)
    planes = world.effects.material_px(x_px, y_px, at)
    centre = world.scan.centre_px
    gradient = motion.gradient[0]
    for axis, image_px in enumerate((x_px, y_px)):
        forward = image_px + motion.shift_px[0, axis] + sum(plane[axis] for plane in planes)
        forward = forward + gradient[axis, 0] * (x_px - centre[0]) + gradient[axis, 1] * (y_px - centre[1])
        address = np.broadcast_to((at.x_px, at.y_px)[axis], image_px.shape)
        beam = address - column.distortion_px[axis] - world.drift.at(at.time_s)[..., axis]
        there = ~world.effects.absent(x_px, y_px, at)
        assert there.mean() > 0.6
        assert np.abs(forward - beam)[there].max() < 1e-4


def test_the_truth_holds_the_field_and_its_mean() -> None:
    world, force = scene(400, 300, hole={**HOLE, "radius_px": 60.0}), 2000.0
    motion = at_rest((0.0, 0.0), world.specimen.gradient(force), force)
    truth = frame_truth(world, "a.tif", 0, 0.0, motion, force, moving=False)
    field = {name: np.array(values) for name, values in truth["field"].items()}
    assert truth["strain"]["eyy"] == pytest.approx(field["eyy"].mean())
    distance = np.hypot(field["x_px"] - 199.5, field["y_px"] - 149.5)
    assert distance.min() >= 60.0
    far_strain = force / (10.0 * 71.1e3)
    assert field["eyy"].max() > 1.2 * far_strain
    assert field["eyy"].min() < 0.6 * far_strain
    exact = EllipticHole(0.0, 0.0, 60.0, 60.0).displacement_px(field["x_px"] - 199.5, field["y_px"] - 149.5, far_strain, NU)
    np.testing.assert_allclose(
        field["u_px"], exact[0] - NU * far_strain * (field["x_px"] - 199.5) - 1e-4 * (field["y_px"] - 149.5), atol=1e-9
    )
    plain = frame_truth(scene(), "a.tif", 0, 0.0, motion, force, moving=False)
    assert "field" not in plain
    assert plain["strain"]["eyy"] == pytest.approx(far_strain)


def test_a_charged_grain_distorts_the_image_and_strains_nothing() -> None:
    lens, force = {"defaults": "x10000", "grains_px": [[80.0, 60.0]]}, 1500.0
    motion = at_rest((0.0, 0.0), scene().specimen.gradient(force), force)
    plain, charged = (
        frame_truth(scene(**chosen), "a.tif", 0, 3000.0, motion, force, moving=False) for chosen in ({}, {"charging_local_lens": lens})
    )
    assert charged == plain
    both = frame_truth(scene(hole=HOLE, charging_local_lens=lens), "a.tif", 0, 3000.0, motion, force, moving=False)
    assert both == frame_truth(scene(hole=HOLE), "a.tif", 0, 3000.0, motion, force, moving=False)


def test_a_hole_is_dark_and_a_notch_reaches_its_edge_of_the_frame() -> None:
    holed = render_frame(scene(hole=HOLE), 0.0) / 256.0
    assert holed[55:65, 75:85].max() < 13.0
    notched = render_frame(scene(notch=NOTCH), 0.0) / 256.0
    assert notched[57:62, 0:45].max() < 13.0
    assert notched[:, 60:].min() > 55.0


def test_plastic_strain_is_ramberg_and_osgoods_and_stays() -> None:
    law = {"area_mm2": 10.0, "proof_stress_mpa": 95.0, "exponent": 2.25}
    effects = build_effects({"plastic_hardening": law})
    history = History((LoadStep(100.0, 950.0), LoadStep(200.0, 1250.0), LoadStep(300.0, -2100.0)))
    load = Motion(np.array([0.0, 400.0]), np.zeros((2, 2)), np.zeros((2, 2, 2)), np.array([100.0, 100.0]), history)
    world = scene()
    times = [50.0, 150.0, 250.0, 350.0]
    mean = [strain_field(effects, world.scan, load, time_s, 0.0, 50.0) for time_s in times]
    for found, peak_mpa in zip(mean, (10.0, 95.0, 220.0, 220.0), strict=True):
        expected = 0.002 * (peak_mpa / 95.0) ** 2.25
        np.testing.assert_allclose(found.eyy, expected, rtol=1e-9)
        np.testing.assert_allclose(found.exx, -0.5 * expected, rtol=1e-9)
    loaded = at_rest(load_n=2000.0)
    np.testing.assert_allclose(strain_field(effects, world.scan, loaded, 0.0, 0.0, 50.0).eyy, 0.002 * (200 / 95) ** 2.25, rtol=1e-9)


def test_grain_strain_has_the_spread_it_reports_and_no_mean() -> None:
    effects = build_effects({"grain_strain": {"seed": 5, "grain_px": 12.0, "strain_sd_per_n": 2e-7}})
    field = strain_field(effects, scene(1000, 1600).scan, at_rest(load_n=2000.0), 0.0, 0.0, 12.0)
    # 12,500 points, correlated over a few neighbours: the spread is known to about 1.5 %, the mean to 2 % of the spread.
    assert field.eyy.std() == pytest.approx(4e-4, rel=0.05)
    assert field.exx.std() == pytest.approx(2e-4, rel=0.05)
    assert abs(field.eyy.mean()) < 0.06 * 4e-4


def test_a_smooth_field_is_the_sum_of_its_bumps_without_a_seam() -> None:
    x, y = np.meshgrid(np.linspace(-40.0, 40.0, 401), np.array([3.0, 9.999999, 10.000001]))
    field = smooth_field(x, y, 7, 10.0)
    assert np.abs(field[2] - field[1]).max() < 1e-5
    step = np.abs(np.diff(field[0]))
    assert step.max() < 0.2 * 5 * math.sqrt(36 / 7) / 10.0  # five standard deviations of a slope
    wide = smooth_field(*np.meshgrid(np.arange(0.0, 3000.0, 7.3), np.arange(0.0, 3000.0, 7.3)), 7, 10.0)
    assert wide.std() == pytest.approx(1.0, rel=0.02)
    assert abs(wide.mean()) < 0.02


def scrambled(z: int) -> int:
    mask = (1 << 64) - 1
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def test_grains_are_voronoi_cells() -> None:
    mask = (1 << 64) - 1
    seeds = []
    for row in range(-4, 9):
        for column in range(-4, 9):
            bits = scrambled((scrambled((3 + column * 0x9E3779B97F4A7C15) & mask) + row * 0xC2B2AE3D27D4EB4F) & mask)
            seeds.append((column + (bits & 0xFFFF) / 65536, row + ((bits >> 16) & 0xFFFF) / 65536, 2 * ((bits >> 32) & 0xFFFF) / 65536 - 1))
    places = np.array(seeds)
    x, y = np.meshgrid(np.arange(0.0, 150.0, 3.1), np.arange(0.0, 300.0, 6.7))
    found = grain_grey(x, y, 3, 30.0, 60.0, 1e-6)
    squares = (x[..., None] / 30.0 - places[:, 0]) ** 2 + (y[..., None] / 60.0 - places[:, 1]) ** 2
    np.testing.assert_allclose(found, places[squares.argmin(axis=-1), 2], atol=1e-12)
    soft = grain_grey(x, y, 3, 30.0, 60.0, 2.0)
    assert 0.01 < (np.abs(soft - found) > 1e-9).mean() < 0.3


def test_grains_look_different_in_the_image() -> None:
    plain, grains = (
        render_frame(scene()) / 256.0,
        render_frame(scene(grain_contrast={"defaults": "x200", "width_px": 40.0, "length_px": 60.0})),
    )
    offset = grains / 256.0 - plain
    assert np.abs(offset).max() <= 12.01
    assert offset.std() > 4.0


@pytest.mark.parametrize("magnification", ["x200", "x10000"])
def test_every_kind_of_specimen_has_defaults_and_survives_being_written_down(magnification: str) -> None:
    chosen = build_effects(dict.fromkeys(MATERIAL, magnification))
    assert [member.name for member in chosen.members] == list(MATERIAL)
    assert build_effects(as_mapping(chosen)) == chosen
    for name in MATERIAL:
        with pytest.raises(ValueError, match="x200 or x10000"):
            build_effects({name: "x300"})
