"""Grey levels of a log's images: effects of the simulated microscope, from bytes in the log to their names."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import pytest
from blind.observing import QUICK
from numexp.stated_estimate import state_estimate

sys.path.insert(0, str(Path(__file__).parent))
from imaged_log import image_data, log_of, moved

from semlive.data.diagnosis.channels import IntensityDiagnosis
from semlive.data.diagnosis.effects import Outcome
from semlive.data.settings import DicSettings
from semlive.diagnose.intensity.verdict import diagnose_intensity
from semlive.report.diagnosis_report import diagnosis_report
from semlive.report.document.html_writer import html_page
from semlive.service.diagnosis.model_file import Model, write_model
from semlive.service.diagnosis.run import diagnose_log
from semlive.service.diagnosis.verdict_json import diagnosis_json
from semlive.service.log.opened_log import OpenedLog
from semlive_simulators.effects.charging import ChargingJump, ChargingLocalLens
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.detector import Contamination, Defocus, GammaChange
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.specimen import at_rest

PAPER = load_scenario("paper_x200")
SCAN = dataclasses.replace(PAPER.scan, width_px=512, height_px=442, frame_time_s=442 * PAPER.scan.row_time_s)
SETTINGS = DicSettings(step_px=15, roi_px=None)
SHIFTS_PX = ((0.0, 0.0), (16.0, 0.0), (-8.0, 5.0), (0.0, 12.0), (20.0, -11.0), (0.0, 0.0))
LOADS_N = (0.0, 0.0, 0.0, 500.0, 1000.0, 1500.0)
FIRST_S = 2.0


def logged(folder: Path, *effects: Effect) -> Path:
    """Six pairs with moves and loads, a quarter of an hour, and the paper's own noise: 5 % of full scale."""
    scenario = dataclasses.replace(PAPER, scan=SCAN, effects=EffectSet(effects))
    column, images, starts_s, at_s = scenario.column(), [], [], FIRST_S
    for pair, (shift_px, load_n) in enumerate(zip(SHIFTS_PX, LOADS_N, strict=True)):
        for member in (0, 1):
            motion = at_rest(shift_px, scenario.specimen.gradient(load_n), load_n)
            images.append(render_frame(scenario, at_s, motion, 2 * pair + member, column))
            starts_s.append(at_s)
            at_s += SCAN.frame_time_s + SCAN.gap_s
        at_s += 60.0
    return log_of(folder / "run", images, SCAN, starts_s, SETTINGS, [moved(*item) for item in enumerate(SHIFTS_PX)])


def grey_of(folder: Path, *effects: Effect) -> IntensityDiagnosis:
    observed = image_data(logged(folder, *effects))
    assert observed.grey is not None
    assert observed.no_grey == ""
    return diagnose_intensity(observed.grey)


def values_and_sigmas(found: IntensityDiagnosis, name: str) -> dict[str, tuple[float, float]]:
    (effect,) = [item for item in found.effects if item.name == name]
    return {item.name: (item.value, item.sigma) for item in effect.parameters}


def close(found: tuple[float, float], truth: float, sigmas: float = 4.0) -> bool:
    return abs(found[0] - truth) < sigmas * found[1]


def test_nothing_is_named_where_nothing_is_and_noise_is_reported(tmp_path: Path) -> None:
    found = grey_of(tmp_path)

    assert (found.outcome, found.effects, found.unexplained) == (Outcome.NONE, (), "")
    assert found.where[0].p_value > 0.01
    dark, slope = found.noise
    assert close((dark.value, dark.sigma), PAPER.detector.read_noise**2 + 1.0 / 12.0)
    assert close((slope.value, slope.sigma), PAPER.detector.shot_noise)
    assert slope.sigma < 0.05


def test_contamination_reduces_mean_and_contrast_equally(tmp_path: Path) -> None:
    found = grey_of(tmp_path, Contamination(2e-5, 1000.0, 860.0))

    assert (found.outcome, [item.name for item in found.effects]) == (Outcome.IDENTIFIED, ["contamination"])
    loss = values_and_sigmas(found, "contamination")["loss_per_s"]
    assert close(loss, 2e-5)
    assert loss[1] < 2e-6


def test_defocus_widens_the_probe_and_preserves_the_mean(tmp_path: Path) -> None:
    found = grey_of(tmp_path, Defocus(5e-4, 0.0))

    assert (found.outcome, [item.name for item in found.effects]) == (Outcome.IDENTIFIED, ["defocus"])
    rate = values_and_sigmas(found, "defocus")["blur_px_per_s"]
    assert close(rate, 5e-4)
    assert rate[1] < 5e-5


def test_another_grey_curve_is_reported_with_its_instant(tmp_path: Path) -> None:
    found = grey_of(tmp_path, GammaChange(1.05, 0.9, -8.0, 600.0))

    assert (found.outcome, [item.name for item in found.effects]) == (Outcome.IDENTIFIED, ["gamma_change"])
    parameters = values_and_sigmas(found, "gamma_change")
    assert all(close(parameters[name], truth) for name, truth in (("gain", 1.05), ("gamma", 0.9), ("offset_levels", -8.0)))
    assert parameters["gamma"][1] < 0.03
    at_s, half_s = parameters["at_s"]
    assert abs(at_s - (600.0 - FIRST_S)) <= half_s < 60.0


def test_local_brightness_is_given_no_name(tmp_path: Path) -> None:
    found = grey_of(tmp_path, ChargingLocalLens(0.3, 80.0, 10.0, 900.0, ((150.0, 150.0),)))

    assert (found.outcome, found.effects) == (Outcome.UNKNOWN, ())
    assert "blocks" in found.unexplained


@pytest.fixture(scope="module")
def jumping(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = logged(tmp_path_factory.mktemp("jump"), ChargingJump(1.0, 1000.0, 25.0, 0.3))
    state_estimate(log / "run.000.mcap", QUICK)  # with the usual parameters the verdict takes 12 s more
    return log


def test_a_jump_with_a_flash_is_a_charges(jumping: Path, tmp_path: Path) -> None:
    model, page = tmp_path / "model.json", tmp_path / "page.html"
    log = OpenedLog(jumping)
    verdict, _ = diagnose_log(log)
    found = diagnosis_json(verdict)
    write_model(model, verdict, log, Model())
    page.write_text(html_page(diagnosis_report("run", verdict)), encoding="utf-8")

    names = [item["name"] for item in found["effects"]]
    assert "charging_jump" in names
    assert "drift_jump" not in names
    parameters = found["effects"][names.index("charging_jump")]["parameters"]
    truth_s = ChargingJump(1.0, 1000.0, 25.0, 0.3).instants_s(900.0)[0] - FIRST_S
    assert abs(parameters["flash_at_s"]["value"] - truth_s - 0.15) < 0.3
    assert abs(parameters["flash_levels"]["value"] - 25.0) < 4.0 * parameters["flash_levels"]["sigma"]
    assert {"x_px", "y_px", "at_s"} <= set(parameters)
    assert found["grey"]["looked_at"] is True
    assert {"intensity"} <= {item["domain"] for item in found["where"]}
    assert "Grey levels" in page.read_text(encoding="utf-8")
    laws = {item["name"]: item["law"]["family"] for item in json.loads(model.read_text(encoding="utf-8"))["effects"]}
    assert laws["charging_jump"] == "drift_jump"
