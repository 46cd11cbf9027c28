"""Specimen, scenario and effects of the simulators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from semlive_simulators.microscope.patterns import Speckle
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import BadScenario, load_scenario, names
from semlive_simulators.specimen.specimen import Motion


@pytest.mark.parametrize("name", ["paper_x200", "short"])
def test_scenarios_have_the_values_of_the_paper(name: str) -> None:
    scenario = load_scenario(name)
    scan = scenario.scan
    assert (scan.width_px, scan.height_px) == (1024, 884)
    assert scan.row_time_s * 884 == pytest.approx(94.67)
    assert scan.row_time_s == pytest.approx(0.107093, abs=1e-6)
    y_px, x_px = np.mgrid[0:884:20, 0:1024:20]
    bend = scenario.distortion.at(x_px, y_px, 1024, 884)
    assert bend.min() > -0.5
    assert 1.2 < bend.max() < 1.5
    drift = scenario.drift.at(np.array([0.0, 94.67, 7200.0]))
    assert 0.3 < np.abs(drift[1]).max() < 0.38
    assert 10 < np.abs(drift[2]).max() < 20
    assert not drift[0].any()


def test_every_scenario_that_comes_along_can_be_read() -> None:
    qualified = ["good", "hum", "poor_stage", "slow_settling", "warm_tungsten", "wrong_row_time"]
    usual = ["paper_x10000", "paper_x200", "paper_x200_fig11", *(f"qualify_{name}" for name in qualified)]
    assert names() == [*usual, "rehearsal", "rehearsal_short", "short"]
    for name in names():
        assert load_scenario(name).name == name


def test_the_full_scenario_calibrates_in_both_axes_and_not_monotonically_in_time() -> None:
    protocol = load_scenario("paper_x200").experiment["protocol"]
    shifts = np.array(protocol["calibration_shifts_px"], dtype=float)
    assert len(shifts) >= 11
    assert not shifts[0].any()
    assert (shifts.min(axis=0) <= -32).all()
    assert (shifts.max(axis=0) >= 32).all()
    order = np.arange(len(shifts))
    assert max(abs(np.corrcoef(order, shifts[:, axis])[0, 1]) for axis in range(2)) < 0.35
    assert len(protocol["loads_n"]) == 7
    assert max(np.diff([0, *protocol["loads_n"]])) <= load_scenario("paper_x200").experiment["limits"]["force_step_max_n"]


def test_the_short_scenario_is_short_and_within_its_limits() -> None:
    experiment = load_scenario("short").experiment
    assert len(experiment["protocol"]["calibration_shifts_px"]) == 5
    assert experiment["protocol"]["loads_n"] == [100, 800, 1500, 2200]
    assert max(np.diff([0, *experiment["protocol"]["loads_n"]])) <= experiment["limits"]["force_step_max_n"]
    assert experiment["specimen"] == {"name": "AL2024-T4", "area_mm2": 10.0, "loading_axis": "y"}


def test_strain_follows_from_the_force() -> None:
    specimen = load_scenario("paper_x200").specimen
    gradient = specimen.gradient(2200.0, yaw_rad=2e-5)
    assert gradient[1, 1] == pytest.approx(220e6 / 71.1e9)
    assert gradient[0, 0] == pytest.approx(-0.33 * 220e6 / 71.1e9)
    assert gradient[0, 1] + gradient[1, 0] == 0.0
    assert gradient[1, 0] == pytest.approx(2200 * specimen.rotation_rad_per_n + 2e-5)
    assert 50e-6 < gradient[1, 0] < 2e-4
    assert specimen.stiffness_n_mm == pytest.approx(14220.0)


def test_the_image_can_be_correlated() -> None:
    scenario = load_scenario("paper_x200")
    image = render_frame(scenario).astype(float)
    assert 35 < image.std() < 45
    fluctuation = image - image.mean()
    power = np.abs(np.fft.fft2(fluctuation)) ** 2
    correlation = np.fft.ifft2(power).real
    correlation /= correlation[0, 0]
    for line in (correlation[0], correlation[:, 0]):
        half = int(np.argmax(line < 0.5))
        assert 2 <= half <= 4  # 5 to 7 px wide at half height
    slope = np.gradient(fluctuation[100:300, 100:300])
    assert min(part.std() for part in slope) > 12


def test_motion_is_looked_up_in_time() -> None:
    motion = Motion(np.array([1.0, 2.0]), np.array([[0.0, 0.0], [4.0, -2.0]]), np.stack([np.zeros((2, 2)), np.eye(2)]))
    at = motion.at(np.array([0.0, 1.25, 9.0]))
    assert at.shift_px.tolist() == [[0, 0], [1, -0.5], [4, -2]]
    assert at.gradient[:, 0, 0].tolist() == [0, 0.25, 1]
    with pytest.raises(ValueError, match="gradient"):
        Motion(np.zeros(2), np.zeros((2, 2)), np.zeros((1, 2, 2)))


def test_dots_must_not_reach_beyond_their_neighbours() -> None:
    with pytest.raises(ValueError, match="further than"):
        Speckle(seed=1, pitch_px=5.0, radius_px=3.2, radius_spread=0.15, presence=0.85, edge_px=2.5)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("extends: paper_x200\nscan: {widht_px: 3}\n", "scan.widht_px"),
        ("extends: paper_x200\nscan: {dwell_time_s: 1.0}\n", "scan: .*too little"),
        ("extends: nowhere\n", "nowhere does not exist"),
        ("- a\n", "holds no keys"),
        ("a: [", "not YAML"),
        ("extends: paper_x200\nexport: {style: telepathy}\n", "'direct', 'rename' or"),
    ],
)
def test_a_bad_scenario_is_refused_with_one_error_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(BadScenario, match=says) as caught:
        load_scenario(str(path))
    assert "\n" not in str(caught.value)
