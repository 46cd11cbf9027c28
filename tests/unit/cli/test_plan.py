"""`semlive plan`: its forecast agrees with past experiments and with propagation of noise."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import yaml
from scipy import ndimage
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.data.grid import Grid
from semlive.data.settings import StrainSettings
from semlive.data.strain import Displacement
from semlive.engine.schedule import TimingAssumptions, dose_c_m2, schedule
from semlive.errors import BadInput
from semlive.mechanics import expected_mean_sigma, expected_sigma, false_strain, mean_gradient, strain, typical_distortion
from semlive.service.config.configuration import parse_config
from semlive.service.config.template import LAB_PRESETS, configuration_text

GIVEN = yaml.safe_load(configuration_text(LAB_PRESETS["modbus-fei"]))
PAPER = Grid(101, 101, 5, 150, 120, 43)


def config(**protocol: Any) -> dict[str, Any]:
    own = {**GIVEN["protocol"], **protocol}
    return {**GIVEN, "sem": {"folder": "export", "pixel_size_um": 1.25, "profile": {"frame_time_s": 94.67}}, "protocol": own}


def plan_report(tmp_path: Path, given: dict[str, Any], *arguments: str) -> dict[str, Any]:
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump(given), encoding="utf-8")
    done = CliRunner().invoke(app, ["plan", str(path), "--json", *arguments])
    if done.exception is not None:
        raise done.exception
    return json.loads(done.stdout)


def test_time_is_that_of_the_simulated_experiment() -> None:
    """The demo's 22 pairs, 94.67 s a frame, hold 30 s: from its first scan to the end of its last one 6179 s passed."""
    steps = {"calibration_shifts_px": [[8 * (k % 2), 0] for k in range(13)], "translation_shifts_px": [[18, -11], [-14, 21]]}
    loads = {"loads_n": [100, 450, 800, 1150, 1500, 1850, 2200], "ramp_rate_n_s": 50}
    times = schedule(parse_config(config(**steps, **loads), "demo").plan(), TimingAssumptions(94.67, 3.0))
    first = times.steps[0]
    assert times.duration_s - (first.motion_s + first.hold_s + 0.5 * 94.67) - 3.0 == pytest.approx(6179.0, rel=0.01)
    assert (times.pair_frames, times.scans) == (44, 66)


def test_triggered_frames_cost_their_export_and_no_other_scan() -> None:
    plan = dataclasses.replace(parse_config(config(), "here").plan(), triggered=True)
    times = schedule(plan, TimingAssumptions(10.0, export_s=2.0))
    assert {round(item.imaging_s, 9) for item in times.steps} == {24.0}
    assert times.scans == times.pair_frames


def test_waiting_time_is_reported_separately() -> None:
    plan = parse_config(config(warm_up={"max_rate_px_s": 0.01, "max_wait_s": 600}), "here").plan()
    assert schedule(plan, TimingAssumptions(10.0)).max_waiting_s == 600.0


def test_dose_is_charge_over_area() -> None:
    assert dose_c_m2(10, 1e-4, 1e-9, 1e-6) == pytest.approx(1.0)


@pytest.mark.parametrize("window", [5, 9])
def test_strain_noise_is_that_of_draws(window: int) -> None:
    """White pixel noise summed over subsets gives neighbours the correlation of overlapping subsets."""
    grid, rng = Grid(0, 0, 5, 40, 40, 21), np.random.default_rng(3)
    drawn, means = [], []
    valid = np.ones(grid.shape, dtype=bool)
    for _ in range(40):
        u, v = (ndimage.uniform_filter(rng.standard_normal((240, 240)), 21)[20:220:5, 20:220:5] * 21 * 0.01 for _ in range(2))
        field = Displacement(1, grid, u, v, np.full(grid.shape, 0.01), np.full(grid.shape, 0.01), valid)
        inner = strain(field, window)
        half = window // 2
        drawn.append([item[half:-half:4, half:-half:4].ravel() for item in (inner.exx, inner.eyy, inner.exy)])
        gradient, _ = mean_gradient(field)
        means.append((gradient[0, 0], gradient[1, 1], 0.5 * (gradient[0, 1] + gradient[1, 0])))
    printed = expected_sigma(grid, window, (0.01, 0.01), StrainSettings())
    assert np.std(np.concatenate(drawn, axis=1), axis=1) == pytest.approx([printed.exx, printed.eyy, printed.exy], rel=0.05)
    whole = expected_mean_sigma(grid, (0.01, 0.01))
    assert np.std(means, axis=0) == pytest.approx([whole.exx, whole.eyy, whole.exy], rel=0.3)


def test_a_typical_distortion_causes_the_apparent_strain_of_the_paper() -> None:
    """Fig. 16: a shift of 5 px gives an apparent exx -1.5e-4 ... 1e-4, exy -3.3e-4 ... 4.3e-4, eyy -4e-4 ... 6e-4."""
    typical = typical_distortion(PAPER, 1024, 884)
    worst = {}
    for shift in ((5.0, 0.0), (0.0, 5.0)):
        field = false_strain(typical, shift, 9)
        for name in ("exx", "exy", "eyy"):
            values = getattr(field, name)[field.valid]
            worst[name] = max(worst.get(name, 0.0), float(np.ptp(values)))
    assert worst == pytest.approx({"exx": 2.5e-4, "exy": 7.6e-4, "eyy": 10e-4}, rel=0.25)


def test_a_test_frame_predicts_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    speckle = ndimage.gaussian_filter(rng.standard_normal((400, 400)), 2.5)
    clean = 128 + 45 * speckle / speckle.std()
    given = config()
    given["dic"] = {"subset_px": 43, "step_px": 10, "roi_px": None}
    given["sem"]["profile"] = {"frame_time_s": 40.0, "row_time_s": 0.1, "dwell_time_s": 2e-4, "pixel_size_m": 1e-6}
    sigma = []
    for noise in (4.0, 8.0):
        image = np.clip(clean + noise * rng.standard_normal(clean.shape), 0, 255).astype(np.uint8)
        tifffile.imwrite(tmp_path / "test.tif", image, datetime=True)
        printed = plan_report(tmp_path, given, "--test-frame", str(tmp_path / "test.tif"), "--current-na", "2")
        sigma.append(np.mean(printed["displacement_sigma_px"]))
        gauge = next(item for item in printed["strain_sigma"] if item["window_points"] == 9)
        assert gauge["vsg_px"] == 123
        assert printed["dose_c_m2"] == pytest.approx(printed["scans"] * 2e-4 * 2e-9 / 1e-12)
        best = printed["recommended"]
        assert (best["method"], best["subset_px"], best["step_px"]) == ("subset", *{4.0: (31, 3), 8.0: (43, 5)}[noise])
        assert max(best["displacement_sigma_px"]) <= {4.0: 0.02, 8.0: 0.05}[noise]
        assert best["strain_sigma"]["vsg_px"] == pytest.approx(123, abs=6)
    assert sigma[1] == pytest.approx(2 * sigma[0], rel=0.1)


def test_what_is_unwise_is_reported_with_what_to_set(tmp_path: Path) -> None:
    given = config(calibration_shifts_px=[[0, 0], [120, 0]], translation_shifts_px=[], hold_s=1, frame_timeout_s=100)
    advice = "\n".join(plan_report(tmp_path, given)["advice"])
    for part in (
        "frame_timeout_s",
        "protocol.hold_s",
        "y direction",
        "out of the frame",
        "warm_up",
        "--test-frame",
        "translation_shifts_px",
    ):
        assert part in advice


def test_small_shifts_are_reported_before_the_run_refuses_them(tmp_path: Path) -> None:
    cross = [[0, 0], [8, 0], [-8, 0], [0, 8], [0, -8]]
    assert "reach 8 px along x and 8 px along y" in "\n".join(plan_report(tmp_path, config(calibration_shifts_px=cross))["advice"])
    wide = [[2 * x, 2 * y] for x, y in cross]
    assert "may be refused" not in "\n".join(plan_report(tmp_path, config(calibration_shifts_px=wide))["advice"])


def test_a_test_frame_that_contradicts_the_configuration_is_reported_first(tmp_path: Path) -> None:
    given = config()
    given["sem"] |= {"vendor": "fei", "profile": {"row_time_s": 0.1071, "dwell_time_s": 1e-4, "pixel_size_m": 2.5e-6}}
    tifffile.imwrite(tmp_path / "flat.tif", np.tile(np.arange(100, 108, dtype=np.uint8), (884, 128)), datetime=True)
    printed = plan_report(tmp_path, given, "--test-frame", str(tmp_path / "flat.tif"))
    vendor, pixel, *_ = printed["advice"]
    assert "sem.vendor is fei, but the test frame is from plain" in vendor
    assert "2.5 um: shifts would be 0.5 times" in pixel


def test_a_frame_without_a_pattern_predicts_no_noise(tmp_path: Path) -> None:
    given = config()
    given["sem"]["profile"] = {"row_time_s": 0.1071, "dwell_time_s": 1e-4, "pixel_size_m": 1.25e-6}
    flat = np.full((884, 1024), 90, dtype=np.uint8)
    flat[:, 5] = 91
    tifffile.imwrite(tmp_path / "flat.tif", flat, datetime=True)
    printed = plan_report(tmp_path, given, "--test-frame", str(tmp_path / "flat.tif"))
    assert printed["displacement_sigma_px"] is None
    assert printed["strain_sigma"] == []
    assert "too little contrast" in "\n".join(printed["advice"])


@pytest.mark.parametrize(("roi_px", "omitted"), [([101, 101, 846, 696], 46), ([36, 31, 986, 851], None), (None, None)])
def test_an_omitted_roi_frame_is_reported(tmp_path: Path, roi_px: list[int] | None, omitted: int | None) -> None:
    given = config()
    given["dic"] = {"roi_px": roi_px}
    given["sem"]["profile"] = {"row_time_s": 0.1071, "dwell_time_s": 1e-4, "pixel_size_m": 1.25e-6}
    flat = np.full((884, 1024), 90, dtype=np.uint8)
    flat[:, 5] = 91
    tifffile.imwrite(tmp_path / "flat.tif", flat, datetime=True)
    advice = "\n".join(plan_report(tmp_path, given, "--test-frame", str(tmp_path / "flat.tif"))["advice"])
    assert ("dic.roi_px excludes" in advice) == (omitted is not None)
    assert omitted is None or f"excludes {omitted} %" in advice


def test_a_plan_beyond_its_limits_is_refused_as_the_run_would(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"line \d+: protocol\.loads_n\.1: a load of 9000 N is outside"):
        plan_report(tmp_path, config(loads_n=[100, 9000]))


def test_without_a_frame_time_it_asks_for_a_frame(tmp_path: Path) -> None:
    given = config()
    del given["sem"]["profile"]
    with pytest.raises(BadInput, match="--test-frame"):
        plan_report(tmp_path, given)
