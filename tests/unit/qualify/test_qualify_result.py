"""Limits are named by their size, files can be read again, and a change counts beyond both intervals only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect
from semlive.errors import BadInput
from semlive.qualify.history import histories
from semlive.qualify.limits import Sources, largest_corrected, limits_of
from semlive.qualify.needs import needs, remaining_pairs
from semlive.qualify.pairing import FrameStep, pair_frames
from semlive.qualify.values import FORMAT_VERSION, Conditions, Figure, GaugeResolution, Protocol, Qualification, Trend, Undetermined
from semlive.report.document.html_writer import html_page
from semlive.report.qualification_report import history_document, qualification_document
from semlive.report.qualification_texts import figure_text
from semlive.service.config.configuration import load_config
from semlive.service.config.plausibility import refuse_unusual
from semlive.service.qualification.files import read_qualification, to_json
from semlive.service.qualification.recommended import configuration_text

CONDITIONS = Conditions("folder", 1_767_600_000_000_000_000, 18, 9, 512, 442, 1e-4, 0.06, 26.52, 1250.0, "fei", True)
PROTOCOL = Protocol(600.0, 0.01, 2.0, 31, 3, 19, ((0.0, 0.0), (12.0, 0.0), (0.0, -12.0)), 26.5, 20.0)
USUAL = Sources(6e-4, 1.0, 1e-5, 1e-6, 1e-5, 1e-6, 0.0, 0.2, 221.0)


def _result(drift: Figure, days: int = 0) -> Qualification:
    conditions = replace(CONDITIONS, time_ns=CONDITIONS.time_ns + days * 86_400_000_000_000)
    missing = (Undetermined("stage", "no positions are given", "give them"),)
    return Qualification(FORMAT_VERSION, conditions, (drift,), missing, (), (), "", "", PROTOCOL)


INSTRUMENT = """
run: {name: lab, segment_gb: 0.5}
sem: {folder: export, pixel_size_um: 25}
load_frame: {driver: modbus, settings: {host: 127.0.0.1}}
stage: {driver: modbus, settings: {host: 127.0.0.1}}
protocol: {calibration_shifts_px: [[0, 0], [12, 0]], loads_n: [100]}
limits:
  {force_min_n: -5, force_max_n: 200, extension_min_mm: 0, extension_max_mm: 1, force_rate_max_n_s: 50, force_step_max_n: 100,
   stage_travel_um: 400, stale_after_s: 2, lost_after_s: 8}
dic: {mask: mask.png}
estimate: {method: sutton2007}
confirmed_unusual: [sem.pixel_size_um]
"""
DRIFT = Figure("drift_rate", "drift rate at the last pair", 0.004, 0.0039, 0.0041, "px/s")


@pytest.mark.parametrize(
    ("changed", "limiting"),
    [
        ({}, "image_noise"),
        ({"drift_strain": 3e-3}, "drift"),
        ({"false_strain_per_px": 3e-4}, "distortion"),
        ({"false_strain_per_px": 3e-4, "row_start_per_px": 2e-4}, "row_start_settling"),
        ({"false_strain_per_px": 1e-4, "stage_residual_px": 20.0}, "stage"),
        ({"image_share": 0.3}, "unexplained_noise"),
    ],
)
def test_the_largest_error_is_the_limit(changed: dict[str, float], limiting: str) -> None:
    limits = limits_of(replace(USUAL, **changed))
    assert limits[0].name == limiting
    assert limits[0].remedy


def test_a_rotation_of_the_specimen_is_no_strain() -> None:
    yaw = IdentifiedEffect("stage_yaw", (), 0.7, 50.0, 1e-3, strain=False, model_effect=ModelEffect("stage_yaw", (), 0.7))
    assert {limit.name for limit in limits_of(replace(USUAL, map_effects=(yaw,)))} == {limit.name for limit in limits_of(USUAL)}


def test_correction_changes_the_limit() -> None:
    limits = limits_of(replace(USUAL, drift_strain=3e-3))
    assert (limits[0].name, largest_corrected(limits)) == ("drift", "image_noise")


def test_pairs_are_frames_without_a_move_between_them() -> None:
    still, moved, other = FrameStep((0.3, -0.2), 0.5, True), FrameStep((12.0, 0.0), 0.5, True), FrameStep((0.0, 0.0), 0.0, False)
    assert pair_frames([still, moved, still, moved, still]) == ((0, 1), (2, 3), (4, 5))
    assert pair_frames([still, still, still]) == ((0, 1), (2, 3))
    assert pair_frames([moved, still, other, moved]) == ((1, 2),)


def test_a_file_is_read_again_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "january.json"
    path.write_text(to_json(_result(DRIFT)), encoding="utf-8")
    assert read_qualification(path) == _result(DRIFT)
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(BadInput, match="is no qualification"):
        read_qualification(path)


def test_the_protocol_is_a_configuration_of_a_run(tmp_path: Path) -> None:
    path = tmp_path / "calibrated.yaml"
    path.write_text(configuration_text(_result(DRIFT), tmp_path / "it's here"), encoding="utf-8")
    config = load_config(path)
    assert config.protocol.calibration_shifts_px == [(0.0, 0.0), (12.0, 0.0), (0.0, -12.0)]
    assert (config.dic.subset_px, config.estimate.window_points, config.load_frame) == (31, 19, None)
    # Twice the dwell of 0.1 ms for 512 columns adds 51.2 ms to a row.
    assert config.sem.profile.row_time_s == pytest.approx(0.1112)
    assert len(config.plan().steps) == 3


def test_the_protocol_takes_over_an_instrument(tmp_path: Path) -> None:
    lab, written = tmp_path / "lab", tmp_path / "elsewhere.yaml"
    lab.mkdir()
    cv2.imwrite(str(lab / "mask.png"), np.full((442, 512), 255, np.uint8))
    (lab / "lab.yaml").write_text(INSTRUMENT, encoding="utf-8")
    written.write_text(configuration_text(_result(DRIFT), tmp_path, lab / "lab.yaml"), encoding="utf-8")
    given, config = load_config(lab / "lab.yaml"), load_config(written)
    assert (config.stage, config.limits, config.dic.mask) == (given.stage, given.limits, given.dic.mask)
    assert config.sem.folder == given.sem.folder
    assert (config.load_frame, config.run.segment_gb, config.estimate.method) == (None, 0.5, "joint")
    refuse_unusual(config, str(written))


@pytest.mark.parametrize("dated", [True, False])
def test_a_day_is_stated_only_if_the_frames_have_it(tmp_path: Path, dated: bool) -> None:
    found = replace(_result(DRIFT), conditions=replace(CONDITIONS, dated=dated))
    configuration = configuration_text(found, tmp_path)
    assert ("of 2026-01-05 in folder" in configuration) is dated
    assert ("2026" in html_page(qualification_document(found, ""))) is dated


def test_qualifications_without_a_date_are_compared_in_the_given_order() -> None:
    much = replace(DRIFT, value=0.006, low=0.0059, high=0.0061)
    newest = _result(much, -30)
    (wrong,) = histories([_result(DRIFT), newest])
    (right,) = histories([_result(DRIFT), replace(newest, conditions=replace(newest.conditions, dated=False))])
    assert (wrong.worse, right.worse) == (False, True)


def test_a_figure_is_worse_beyond_both_intervals_only() -> None:
    slightly = replace(DRIFT, value=0.00415, low=0.00405, high=0.00425)
    much = replace(DRIFT, value=0.006, low=0.0059, high=0.0061)
    (near,) = histories([_result(slightly, 30), _result(DRIFT)])
    (far,) = histories([_result(much, 30), _result(DRIFT)])
    (better,) = histories([_result(DRIFT, 30), _result(much)])
    assert (near.worse, far.worse, better.worse) == (False, True, False)
    assert better.change is Trend.SMALLER
    page = html_page(history_document([_result(much, 30), _result(DRIFT)]))
    assert "drift rate at the last pair from 0.004 to 0.006 px/s" in page


def test_a_figure_needs_pairs_until_its_interval_is_narrow_or_it_is_negligible() -> None:
    noise = Figure("noise_31", "noise", 0.02, 0.014, 0.026, "px")  # known to 30 %, by nine pairs
    strain = Figure("false_strain_per_px", "false strain", 1e-5, 0.0, 4e-5, "1/px")
    resolution = (GaugeResolution(83, 100.0, 6e-4, 5e-4, 7e-4, 0.0, 0.0),)
    missing = (
        Undetermined("drift_decay", "no decay", "none is needed", by_pairs=False),
        Undetermined("row_start_law", "one dwell", "take another"),
    )
    found = replace(_result(DRIFT), figures=(noise, strain), undetermined=missing, resolution=resolution)
    (need,) = needs(found)
    assert (need.name, need.pairs, remaining_pairs((need,), 100), remaining_pairs((need,), 4)) == ("noise_31", 27, 27, 4)
    narrow = replace(found, figures=(replace(noise, low=0.018, high=0.022), replace(strain, high=9e-5)))
    assert [need.name for need in needs(narrow)] == ["false_strain_per_px"]
    assert remaining_pairs((), 4) == 0
    first = replace(found, figures=(), undetermined=(Undetermined("distortion", "no shifts", "shift"),))
    assert [(need.name, need.pairs) for need in needs(first)] == [("distortion", None)]


def test_digits_follow_the_interval() -> None:
    assert figure_text(DRIFT) == ("0.004", "0.0039 to 0.0041")
