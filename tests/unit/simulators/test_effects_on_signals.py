"""Effects on grey levels, blur, sensors and truth, against their formulas."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from semlive_simulators.effects.interfaces import Instants
from semlive_simulators.effects.library import as_mapping, build_effects
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.history import History, LoadStep
from semlive_simulators.specimen.machine import LoadTrain
from semlive_simulators.specimen.specimen import at_rest
from semlive_simulators.truth import TruthRecorder, frame_truth

from .calm_scenario import calm


def levels(scenario: Scenario, start_s: float, frame: int = 0) -> NDArray[np.float64]:
    """Grey levels of 8 bit."""
    return render_frame(scenario, start_s, frame=frame) / 256.0


def test_grey_follows_the_formulas() -> None:
    start_s, size = 598.0, (64, 80)
    y_px, x_px = np.mgrid[0 : size[1], 0 : size[0]].astype(float)
    plain = levels(calm("x200", {}, *size), start_s)
    time_s = start_s + y_px * load_scenario("paper_x200").scan.row_time_s + x_px * 1e-4

    changed = levels(calm("x200", {"gamma_change": "x200"}, *size), start_s)
    expected = np.where(time_s < 600.0, plain, 255 * 1.05 * (plain / 255) ** 0.9 - 8)
    assert np.abs(changed - expected).max() < 0.02

    box = {"loss_per_s": 2e-4, "box_width_px": 40.0, "box_height_px": 30.0}
    dirty = levels(calm("x200", {"contamination": box}, *size), start_s)
    inside = (np.abs(x_px - 31.5) <= 20) & (np.abs(y_px - 39.5) <= 15)
    assert np.abs(dirty - np.where(inside, plain * (1 - 2e-4 * time_s), plain)).max() < 0.02

    ramp = {"x_px": 0.0, "y_px": 0.0, "brightness_levels": 9.0, "charging_s": 3.0, "dose_s": 700.0}
    charged = levels(calm("x200", {"charging_frame_ramp": ramp}, *size), start_s)
    charge = (1 - np.exp(-(time_s - start_s) / 3.0)) * (1 - math.exp(-start_s / 700.0))
    assert np.abs(charged - plain - 9.0 * charge).max() < 0.02

    lens = {"peak_px": 0.0, "width_px": 12.0, "brightness_levels": 20.0, "charging_s": 900.0, "grains_px": [[20.0, 30.0]]}
    lit = levels(calm("x200", {"charging_local_lens": lens}, *size), start_s)
    glow = 20.0 * (1 - np.exp(-time_s / 900.0)) * np.exp(-0.5 * ((x_px - 20) ** 2 + (y_px - 30) ** 2) / 144.0)
    assert np.abs(lit - plain - glow).max() < 0.02

    both = levels(calm("x200", {"gamma_change": "x200", "contamination": box}, *size), start_s)
    first = np.where(inside, plain * (1 - 2e-4 * time_s), plain)
    assert np.abs(both - np.where(time_s < 600.0, first, 255 * 1.05 * (first / 255) ** 0.9 - 8)).max() < 0.02


def test_a_discharge_flashes_when_it_jumps() -> None:
    chosen = {"charging_jump": {"sd_px": 0.0, "mean_interval_s": 6.0, "flash_levels": 30.0, "flash_s": 0.3}}
    scenario = calm("x200", chosen, 64, 80)
    (effect,) = scenario.effects.members
    brighter = levels(scenario, 0.0) - levels(calm("x200", {}, 64, 80), 0.0)
    first_s = effect.instants_s(8.0)[0]  # type: ignore[attr-defined]
    row_s = scenario.scan.row_time_s
    rows = np.flatnonzero(brighter.mean(axis=1) > 15.0)
    assert rows[0] * row_s == pytest.approx(first_s, abs=row_s)
    assert brighter.max() == pytest.approx(30.0, abs=0.02)


def test_noise_is_as_large_as_the_electrons_make_it() -> None:
    chosen = {"poisson_noise": {"dark_variance_levels2": 2.0, "levels_per_electron": 0.6}}
    clean = levels(calm("x200", {}, 384, 256), 0.0)
    noisy = levels(calm("x200", chosen, 384, 256), 0.0, frame=5)
    normal = (noisy - clean) / np.sqrt(2.0 + 0.6 * clean)
    assert abs(normal.std() - 1) < 4 / math.sqrt(2 * normal.size)


def test_defocus_blurs_like_a_spot_of_that_size() -> None:
    blurred = calm("x200", {"defocus": {"blur_px_per_s": 1e-4, "magnification_per_px": 0.0}}, 96, 64)
    spot = calm("x200", {}, 96, 64)
    spot = dataclasses.replace(spot, scan=dataclasses.replace(spot.scan, spot_px=0.7))
    assert np.abs(levels(blurred, 7000.0) - levels(spot, 7000.0)).max() < 0.05
    assert levels(blurred, 7000.0).std() < 0.97 * levels(calm("x200", {}, 96, 64), 7000.0).std()


def test_an_astigmatic_probe_blurs_along_its_axis() -> None:
    slopes = []
    for axis_rad in (0.0, math.pi / 2, math.pi / 4):
        chosen = {"blur_px_per_s": 1e-4, "magnification_per_px": 0.0, "astigmatism_px_per_s": 1e-4, "axis_rad": axis_rad}
        image = levels(calm("x200", {"defocus": chosen}, 160, 120), 7000.0)
        diagonal = image[1:, 1:] - image[:-1, :-1]
        across = image[:-1, 1:] - image[1:, :-1]
        slopes.append([np.diff(image, axis=1).std(), np.diff(image, axis=0).std(), diagonal.std(), across.std()])
    along_x, along_y, oblique = slopes
    # A line of sigma 1.4 px takes most along itself and nothing across.
    assert along_x[0] < 0.85 * along_x[1]
    assert along_y[1] < 0.85 * along_y[0]
    assert oblique[2] < 0.85 * oblique[3]
    sharp = levels(calm("x200", {}, 160, 120), 7000.0)
    assert along_x[1] > 0.8 * np.diff(sharp, axis=0).std()


def test_the_probe_has_the_covariance_of_all_that_blurs() -> None:
    chosen = {"blur_px_per_s": 3e-4, "magnification_per_px": 0.0, "astigmatism_px_per_s": 1e-4, "axis_rad": 0.7}
    scenario = calm("x200", {"defocus": chosen}, 64, 48)
    scan = dataclasses.replace(scenario.scan, spot_px=0.5)
    at = Instants(np.array([0.0, 2000.0]), 0.0, 0, scan, at_rest())
    probe = scenario.effects.optics().probe_px(at)
    found = probe @ probe.transpose(0, 2, 1)
    turn = np.array([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]])
    np.testing.assert_allclose(found[0], 0.25 * np.eye(2), atol=1e-12)
    np.testing.assert_allclose(found[1], 0.25 * np.eye(2) + turn @ np.diag([0.8**2, 0.4**2]) @ turn.T, atol=1e-12)


def test_sharper_dots_do_not_move() -> None:
    sharp, soft = calm("x200", {"dic_subpixel_bias": "x200"}, 160, 120), calm("x200", {}, 160, 120)
    assert sharp.column().speckle.edge_px == pytest.approx(0.16 * soft.speckle.edge_px)
    slopes = [np.abs(np.diff(levels(scenario, 0.0), axis=1)).max() for scenario in (sharp, soft)]
    assert slopes[0] > 1.5 * slopes[1]
    rows = range(0, 4)
    assert np.array_equal(
        sharp.column().specimen_points(rows, 0, 0.0, at_rest(), 0)[0], soft.column().specimen_points(rows, 0, 0.0, at_rest(), 0)[0]
    )


def test_instrument_readings_follow_their_formulas() -> None:
    motion = at_rest(load_n=1000.0, history=History((LoadStep(5.0, 1200.0), LoadStep(50.0, -200.0))))
    cases: dict[str, tuple[dict[str, float], float]] = {
        "load_cell_zero": ({"zero_n": 20.0}, 1020.0),
        "load_cell_gain": ({"gain_error": 0.02}, 1020.0),
        "load_cell_drift": ({"rate_n_per_s": 0.5}, 1050.0),
        "friction_hysteresis": ({"friction_n": 15.0}, 985.0),
    }
    for name, (parameters, reading_n) in cases.items():
        assert build_effects({name: parameters}).readings().load_n(1000.0, 100.0, motion) == pytest.approx(reading_n)
    rising = build_effects({"friction_hysteresis": {"friction_n": 15.0}}).readings()
    assert rising.load_n(1200.0, 20.0, motion) == 1215.0
    both = build_effects({"load_cell_zero": {"zero_n": 20.0}, "load_cell_gain": {"gain_error": 0.02}}).readings()
    assert both.load_n(1000.0, 0.0, motion) == pytest.approx(1.02 * 1020.0)
    soft = build_effects({"load_frame_compliance": {"fixture_stiffness_n_mm": 4000.0}}).readings()
    assert soft.extension_mm(0.1, 1000.0) == pytest.approx(0.35)
    late = dataclasses.replace(load_scenario("paper_x200"), effects=build_effects({"timestamp_offset": {"offset_s": -2.5}}))
    assert late.stamp_ns(9_000_000_000, 1_000_000_000) == 6_500_000_000


@pytest.mark.parametrize("name", ["load_cell_zero", "load_cell_gain", "friction_hysteresis"])
def test_the_load_frame_controls_by_its_cell(name: str) -> None:
    scenario = dataclasses.replace(load_scenario("paper_x200"), effects=build_effects({name: "x200"}))
    silent = dataclasses.replace(scenario.load_frame, cell_noise_n=0.0, relaxation_fraction=0.0)
    machine = LoadTrain(dataclasses.replace(scenario, load_frame=silent), 0)
    machine.ramp_to(1000.0, 100.0)
    reading = machine.read(30_000_000_000)
    assert reading.force_n == pytest.approx(1000.0, abs=1.05)  # 1 N of true force is arrived
    assert reading.target_n == pytest.approx(1000.0)
    true_n = machine.window(29.0, 30.0).force_mean_n
    assert true_n == pytest.approx({"load_cell_zero": 980.0, "load_cell_gain": 1000 / 1.02, "friction_hysteresis": 985.0}[name], abs=1.1)


def test_the_machine_stores_its_history() -> None:
    scenario = load_scenario("paper_x200")
    machine = LoadTrain(scenario, 0)
    machine.move_stage(10.0, -5.0)
    machine.advance_to(5_000_000_000)
    machine.ramp_to(200.0, 100.0)
    machine.advance_to(20_000_000_000)
    motion = machine.window(19.0, 20.0).motion
    (move,), (step,) = motion.history.moves, motion.history.load_steps
    assert move.to_px == pytest.approx((8.0, -4.0), abs=1.0)
    assert 0.4 < move.time_s < 1.0
    assert step.change_n == pytest.approx(200.0, abs=2.0)
    assert 6.0 < step.time_s < 15.0
    assert motion.load_at(np.array([19.5])) == pytest.approx(200.0, abs=2.0)


def test_truth_reports_effects_drift_and_strain() -> None:
    chosen = {"creep_in_hold": "x200", "thermal_oscillation": "x200"}
    scenario = dataclasses.replace(load_scenario("paper_x200"), effects=build_effects(chosen))
    history = History((LoadStep(10.0, 2000.0),))
    frame = frame_truth(scenario, "a.tif", 0, 40.0, at_rest(load_n=2000.0, history=history), 2000.0, False)
    creep = 6e-8 * 2000.0 * math.log(1 + (40.0 + 94.67 / 2 - 10.0) / 10.0)
    assert frame["strain"]["eyy"] == pytest.approx(creep)
    truth = TruthRecorder(scenario, 0)
    truth.add_frame(frame, history)
    reported = json.loads(truth.encode(100_000_000_000, 0, 0.0))
    assert reported["effects"] == as_mapping(scenario.effects)
    time_s = np.array(reported["drift"]["time_ns"]) * 1e-9
    expected = scenario.drift.at(time_s)[:, 1] + 0.2 * np.sin(2 * np.pi * time_s / 480.0 + 0.7)
    np.testing.assert_allclose(reported["drift"]["dy_px"], expected, atol=1e-12)
